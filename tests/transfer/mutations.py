"""Random changes of an export, with valid checksums, as an attacker or a bug elsewhere would make them."""

import json
from zlib import crc32

JUNK = (
    *(None, True, False, -1, 0, 1, 2**31, 2**62, 2**63 - 1, 2**63, 10**30, 1.5, float("nan"), float("inf")),
    *("", "\0", "\ud800", "\x1b[2J", "a b", "(", "(and", "?x", [], {}, [1]),
)
"""Values that few columns accept."""


def sealed(lines):
    """Lines with valid checksums."""
    seal, text = 0, b""
    for line in lines:
        body = (line if isinstance(line, str) else json.dumps(line)).encode()[:-1]
        seal = crc32(body, seal)
        text += body + b', "check": "%08x"}\n' % seal
    return text


def unsealed(text):
    """The lines of an export as mappings, without their checksums."""
    lines = [json.loads(line) for line in text.splitlines()]
    for line in lines:
        del line["check"]
    return lines


def mutated(lines, chance):
    """The lines with one random change, now and then two; and a description of the changes."""
    lines = [dict(line) for line in lines]
    number = 0 if chance.random() < 0.1 else chance.randrange(len(lines))
    line = lines[number]
    if not number and chance.random() < 0.2:
        line = line["rows"] = dict(line["rows"])
    name = chance.choice(list(line))
    value = line[name]
    others = [other[name] for other in lines if name in other and other.get("table") == line.get("table")]
    match chance.randrange(8):
        case 0:
            del line[name]
        case 1:
            line[name] = chance.choice(JUNK)
        case 2 | 3 if others:
            line[name] = chance.choice(others)
        case _:
            line[name] = _near(value, chance)
    what = f"line {number + 1}: {name} {value!r:.60} -> {line.get(name)!r:.60}"
    if chance.random() < 0.05:
        dropped = chance.randrange(1, len(lines) - 1)
        del lines[dropped]
        what += f", without line {dropped + 1}"
    return lines, what


def _near(value, chance):
    """A value close to another."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return max(0, value + chance.choice((-1, 1, 2, -(10**9), 10**9, 3 * 10**9)))
    if isinstance(value, float):
        return value + chance.choice((1.0, -0.5, 1e300))
    if isinstance(value, str):
        place = chance.randrange(len(value) + 1)
        more = chance.choice(("x", "(", ")", " ", "\n", "-", "?", "A", "", " b"))
        return value[:place] + more + value[place + chance.randrange(2) :]
    return 0
