"""The functions that processes sharing a store run."""

import os

import kbstore
from kbstore.errors import Conflict

FULL = bool(os.environ.get("KBSTORE_TEST_FULL"))
"""Whether to run the long tests; the usual run has fewer repetitions."""


def increment(url, name, times, together):
    """Increase a counter, when all are ready."""
    with kbstore.open(url, name) as kb:
        together.wait()
        for _ in range(times):
            kb.add("(increase (counter) 1)")


def open_and_add(url, name, number, together):
    """Open a new knowledge base, all processes at once, and add something."""
    together.wait()
    with kbstore.open(url, name) as kb:
        kb.add(f"(here p{number})")


def race(url, name, me, rounds, together, won):
    """In each round all processes expect the same transaction to be the latest, and try to write the next."""
    with kbstore.open(url, name) as kb:
        latest = 1
        for _ in range(rounds):
            together.wait()
            latest = max((change.number for change in kb.changes(after=latest)), default=latest)
            together.wait()
            try:
                with kb.transaction(expect=latest, client=f"p{me}") as transaction:
                    transaction.add(f"(holder p{me} t{latest})")
            except Conflict:
                continue
            won.put((latest, me, transaction.result.number))


def write(url, name, me, times):
    """Add one thing after another."""
    with kbstore.open(url, name) as kb:
        for number in range(times):
            kb.add(f"(seen p{me} n{number})", client=f"p{me}")


def follow(url, name, after, upto, seen):
    """Ask for changes again and again, each time after the last number."""
    with kbstore.open(url, name) as kb:
        while after < upto:
            for change in kb.changes(after=after):
                after = change.number
                seen.put((change.number, str(change.asserted[0].item)))


def watch(url, name, after, upto, seen):
    """Watch until a transaction comes."""
    with kbstore.open(url, name) as kb:
        for change in kb.watch(after=after, poll=0.005):
            seen.put((change.number, str(change.asserted[0].item)))
            if change.number >= upto:
                return


def keep_watching(url, name, diary, upto):
    """Watch until a transaction comes, recording each change in a file; continue after the last one recorded there."""
    with kbstore.open(url, name) as kb, open(diary, "a+b", buffering=0) as file:
        file.seek(0)
        noted = file.read()
        # a line cut off by the kill was not recorded
        file.truncate(noted.rfind(b"\n") + 1)
        after = max((int(line) for line in noted.split(b"\n")[:-1]), default=0)
        while after < upto:
            for change in kb.watch(after=after, poll=0.005, timeout=0.5):
                file.write(b"%d\n" % change.number)
                after = change.number
                if after >= upto:
                    break
