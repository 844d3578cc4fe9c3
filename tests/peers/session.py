"""Runs renderers as processes, with the time from their start and the processor time that they take.

Processor time hardly depends on what else the machine does.
"""

import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

# What a worker puts before each message that is meant for this program; renderers print lines of their own.
MARK = "@@"


class Failed(Exception):
    """A process that failed, with what it said."""


def run(command, variables=None):
    """Runs a process to its end; returns its seconds, the processor's seconds, and its output."""
    with tempfile.TemporaryFile("w+", errors="replace") as output:
        started = time.perf_counter()
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=variables)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        said = output.read()
    if process.returncode:
        raise Failed(f"`{' '.join(map(str, command))}` failed: {said[-800:]}")
    return seconds, usage.ru_utime + usage.ru_stime, said


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
        """Waits for the worker's next reply; adds the seconds `since_start`, and the processor's until now."""
        said = []
        for line in self.process.stdout:
            # Colour codes of a renderer's own messages may precede the mark
            if MARK in line:
                reply = json.loads(line.partition(MARK)[2])
                reply["since_start"] = time.perf_counter() - self.started
                reply["processor"] = self.processor()
                return reply
            said.append(line)
        raise Failed(f"`{' '.join(map(str, self.process.args))}` ended: {''.join(said)[-1500:]}")

    def processor(self):
        """Returns the processor seconds of the worker until now."""
        words = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

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
