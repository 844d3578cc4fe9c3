"""Runs renderers as processes, with the time from their start."""

import json
import subprocess
import time

# What a worker puts before each message that is meant for this program; renderers print lines of their own.
MARK = "@@"


class Failed(Exception):
    """A process that failed, with what it said."""


def run(command, variables=None):
    """Runs a process to its end; returns its seconds and its output."""
    started = time.perf_counter()
    result = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=variables)
    seconds = time.perf_counter() - started
    if result.returncode:
        raise Failed(f"`{' '.join(map(str, command))}` failed: {result.stdout[-800:]}")
    return seconds, result.stdout


class Session:
    """A worker that has loaded a scene and renders it on request."""

    def __init__(self, command, variables=None):
        self.started = time.perf_counter()
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=variables,
        )
        self.ready = self.reply()

    def reply(self):
        """Waits for the worker's next reply; `since_start` is added to it."""
        said = []
        for line in self.process.stdout:
            # Colour codes of a renderer's own messages may precede the mark
            if MARK in line:
                reply = json.loads(line.partition(MARK)[2])
                reply["since_start"] = time.perf_counter() - self.started
                return reply
            said.append(line)
        raise Failed(f"`{' '.join(map(str, self.process.args))}` ended: {''.join(said)[-1500:]}")

    def render(self, **request):
        """Sends one request; returns the reply."""
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        return self.reply()

    def close(self):
        """Ends the worker."""
        self.process.stdin.close()
        self.process.stdout.read()
        self.process.wait()
