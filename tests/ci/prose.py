#!/usr/bin/env python3
"""Counts, over `src`, words that the field has others for, comments that do not stand alone, and types of the same name.

    tests/ci/prose.py           prints the counts, and fails if one is above its limit (or below, for a minimum)
    tests/ci/prose.py --list    prints every doc comment and every type name that is counted, too

A limit is the count of today: a commit that lowers a count lowers its limit, too.
"""

import collections
import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]

# Name, pattern (within identifiers too: parts between underscores and capitals are words), limit.
WORDS = [
    ("feel, feeler: shadow ray", r"feel\w*", 0),
    ("MOST_, LEAST_: MAX_, MIN_", r"MOST_|LEAST_", 0),
    ("ask, answer, meet, met, tell, told", r"ask(s|ed|ing)?|answer(s|ed|ing)?|meet(s|ing|ings)?|met|tell(s|ing)?|(fore)?told|foretell(s)?", 15),
    ("picture: image", r"pictures?", 30),
    ("lamp: emissive object, area light", r"lamps?", 18),
    ("sheet: thin surface", r"sheets?", 21),
    ("larder, shelf: cache", r"larders?|shelf|shelves", 0),
    ("swallow, shine, glow: absorb, emit", r"swallow\w*|shines?|shining|glows?|glowing", 0),
    ("lecture: Phong, Whitted", r"lectures?", 20),
    ("whoever, nobody, somebody, anybody, dear", r"whoever|nobody|somebody|anybody|dear", 0),
]
QUESTION = re.compile(r"(What|How|Whether|Where|Which|Who|Whose|When)\b")
# Words of a doc comment, at least.
MIN_WORDS = 4


def split_words(line):
    """Returns the line with its identifiers taken apart at underscores and capitals."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|_(?=[a-z])|(?<=[a-z])_", " ", line)


def doc_blocks(lines):
    """Yields the first line's number and the text of each doc comment of an item (`///`)."""
    start, text = None, []
    for number, line in enumerate(lines, 1):
        match = re.match(r"\s*///(?!/) ?(.*)", line)
        if match:
            if start is None:
                start = number
            text.append(match[1])
        elif start is not None:
            yield start, " ".join(text).strip()
            start, text = None, []


def main():
    listing = "--list" in sys.argv[1:]
    words = {name: 0 for name, _, _ in WORDS}
    questions, fragments, blocks, inline, non_blank = [], [], 0, 0, 0
    types = collections.defaultdict(list)
    for path in sorted((ROOT / "src").rglob("*.rs")):
        name = path.relative_to(ROOT).as_posix()
        lines = path.read_text().splitlines()
        for line in lines:
            if not line.strip():
                continue
            non_blank += 1
            inline += bool(re.search(r"(^|\s)//(?![/!])", line))
            apart = split_words(line)
            for label, pattern, _ in WORDS:
                # Capitals and underscores are part of some patterns; words stand alone in all others
                if pattern.isupper() or "_" in pattern:
                    words[label] += len(re.findall(rf"\b(?:{pattern})", line))
                else:
                    words[label] += len(re.findall(rf"\b(?:{pattern})\b", apart, re.IGNORECASE))
            match = re.match(r"\s*(?:pub(?:\([\w ]+\))? )?(?:struct|enum|trait|union|type) (\w+)", line)
            # Types inside functions, and types that a trait names, are not looked up by name
            if match and not line.startswith("        ") and not re.match(r"\s+(pub )?type ", line):
                types[match[1]].append(name)
        for number, text in doc_blocks(lines):
            blocks += 1
            if QUESTION.match(text):
                questions.append(f"{name}:{number}: {text[:90]}")
            if len(text.split()) < MIN_WORDS:
                fragments.append(f"{name}:{number}: {text}")
    doubles = {name: places for name, places in types.items() if len(set(places)) > 1}
    rows = [(label, words[label], limit, True) for label, _, limit in WORDS]
    rows += [
        ("doc comments that begin with a question word, in 1000", round(1000 * len(questions) / blocks), 0, True),
        ("doc comments of fewer than four words", len(fragments), 0, True),
        ("names that several types have", len(doubles), 18, True),
        ("lines with a comment that is no doc comment, in 1000", round(1000 * inline / non_blank), 33, False),
    ]
    if listing:
        print("\n".join(questions + fragments))
        for name, places in sorted(doubles.items()):
            print(f"{name}: {', '.join(places)}")
    failed = False
    for label, count, limit, is_most in rows:
        bad = count > limit if is_most else count < limit
        failed |= bad
        print(f"{label:58} {count:6} {'at most' if is_most else 'at least'} {limit:6}{'  <- too ' + ('many' if is_most else 'few') if bad else ''}")
    sys.exit(failed)


if __name__ == "__main__":
    main()
