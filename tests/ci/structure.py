#!/usr/bin/env python3
"""Checks which files of src import which: no large circles, and no folder that imports a later one.

    tests/ci/structure.py             prints the counts, and fails if one is above its limit
    tests/ci/structure.py --list      prints every circle and every upward import

An import is a name in a `use` line outside of unit tests. A name that a module only re-exports counts as imported from the
file that defines it. Two files that need each other form a circle, and so do more that need each other in a ring.
"""

import re
import sys
from collections import defaultdict
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src"

# Folders (or files of the same name) in layers: each may import its own layer's earlier entries and all earlier layers.
LAYERS = """
    processor_time parallel buffer manual numeric shape mesh optics volume image scene shading gltf accel scene_file jobs render batch measure
    cost verify bench watch report cli main
""".split()

# Limits are what there is today, or better: lower them when a count falls.
MAX_CIRCLE = 3
MAX_LARGE_CIRCLES = 0
MAX_UPWARD_IMPORTS = 0


def modules():
    """Returns the file of each module path."""
    found = {}
    for file in sorted(SOURCE.rglob("*.rs")):
        parts = list(file.relative_to(SOURCE).with_suffix("").parts)
        if parts[-1] == "mod":
            parts.pop()
        if parts == ["lib"]:
            parts = []
        found[tuple(parts)] = file
    return found


def code(file):
    """Returns a file's text without comments and unit tests."""
    text = re.sub(r"//[^\n]*", "", file.read_text())
    return re.split(r"#\[cfg\(test\)\]\s*mod \w+ \{", text)[0]


def paths(tree):
    """Yields each path of a `use` tree as a tuple of names."""
    depth, start, items = 0, 0, []
    for at, letter in enumerate(tree + ","):
        depth += (letter == "{") - (letter == "}")
        if letter == "," and depth == 0:
            items.append(tree[start:at].strip())
            start = at + 1
    for item in filter(None, items):
        head, brace, rest = item.partition("{")
        names = [name.strip() for name in head.strip().split("::") if name.strip()]
        if brace:
            for path in paths(rest.rstrip()[:-1]):
                yield (*names, *path)
        else:
            yield tuple(name.split(" as ")[0].strip() for name in names)


def imports(files):
    """Returns the private imports and the re-exports of each module, as absolute paths."""
    private, exported = defaultdict(list), defaultdict(dict)
    statement = re.compile(r"(?m)^[ \t]*(pub(?:\([^)]*\))?\s+)?use\s+([^;]+);")
    for module, file in files.items():
        for public, tree in statement.findall(code(file)):
            for path in paths(" ".join(tree.split())):
                at = absolute(path, module, files)
                if at is None:
                    continue
                if public:
                    exported[module][at[-1]] = at
                else:
                    private[module].append(at)
    return private, exported


def absolute(path, module, files):
    """Returns the path from the crate's root, or None for another crate."""
    base, names = list(module), list(path)
    if names[0] in ("crate", "whit"):
        base, names = [], names[1:]
    elif names[0] in ("super", "self"):
        while names and names[0] in ("super", "self"):
            if names.pop(0) == "super":
                base.pop()
    elif (*module, names[0]) not in files:
        return None
    return tuple(base + names) if names else tuple(base) or None


def defined_in(path, files, exported):
    """Returns the module that defines what a path names, through re-exports."""
    for _ in range(20):
        length = max(n for n in range(len(path) + 1) if path[:n] in files)
        module, rest = path[:length], path[length:]
        target = exported.get(module, {}).get(rest[0]) if rest else None
        if target is None or target[: len(path)] == path:
            return module
        path = (*target, *rest[1:])
    return module


def circles(edges):
    """Returns the strongly connected components of more than one file (Tarjan)."""
    index, low, stack, on_stack, found = {}, {}, [], set(), []

    def visit(node):
        index[node] = low[node] = len(index)
        stack.append(node)
        on_stack.add(node)
        for target in edges[node]:
            if target not in index:
                visit(target)
                low[node] = min(low[node], low[target])
            elif target in on_stack:
                low[node] = min(low[node], index[target])
        if low[node] == index[node]:
            component = []
            while not component or component[-1] != node:
                component.append(stack.pop())
                on_stack.discard(component[-1])
            if len(component) > 1:
                found.append(sorted(component))

    for node in list(edges):
        if node not in index:
            visit(node)
    return sorted(found, key=len, reverse=True)


def main():
    sys.setrecursionlimit(10_000)
    files = modules()
    private, exported = imports(files)
    edges = {module: set() for module in files}
    upward = []
    for module, targets in private.items():
        for path in targets:
            target = defined_in(path, files, exported)
            if target == module or not target:
                continue
            edges[module].add(target)
            if module and LAYERS.index(target[0]) > LAYERS.index(module[0]):
                upward.append(f"{'/'.join(module)} -> {'/'.join(target)}")
    found = circles(edges)
    large = [circle for circle in found if len(circle) > MAX_CIRCLE]
    if "--list" in sys.argv:
        for circle in found:
            print(f"{len(circle)} files:", *("/".join(module) for module in circle))
        print(*sorted(set(upward)), sep="\n")
    counts = [
        (f"circles of more than {MAX_CIRCLE} files", len(large), MAX_LARGE_CIRCLES),
        ("imports of a later folder", len(set(upward)), MAX_UPWARD_IMPORTS),
    ]
    print(f"{len(files)} files, {len(found)} circles, the largest of {max(map(len, found), default=0)} files")
    for label, count, limit in counts:
        print(f"{label:40} {count:4} at most {limit:4}{'  <- too many' if count > limit else ''}")
    return any(count > limit for _, count, limit in counts)


if __name__ == "__main__":
    sys.exit(main())
