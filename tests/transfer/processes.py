"""The functions of processes that archive or push, and are killed at a given call of the database."""

import os
import signal

import kbstore
from kbstore.storage.connection import StoreConnection
from kbstore.transfer import push as pushing
from tests.processes import TOO_LONG, start

CALLS = ("begin", "commit", "run", "many")


def calling(act):
    """Have `act` called before each writing call of the database; return a function that undoes this."""
    originals = {name: getattr(StoreConnection, name) for name in CALLS}

    def wrapped(original):
        def call(*arguments, **options):
            act()
            return original(*arguments, **options)

        return call

    for name, original in originals.items():
        setattr(StoreConnection, name, wrapped(original))

    def restore():
        for name, original in originals.items():
            setattr(StoreConnection, name, original)

    return restore


def dying(killed_at):
    """Be killed (as by kill -9) right before the given call, counted from 1."""
    made = 0

    def count():
        nonlocal made
        made += 1
        if made == killed_at:
            os.kill(os.getpid(), signal.SIGKILL)

    calling(count)


def archive(url, name, before, path, killed_at):
    """Archive, and be killed."""
    kb = kbstore.open(url, name)
    dying(killed_at)
    kb.archive(before, path)


def push(url, name, target, chunk, killed_at):
    """Push in parts of a size, and be killed."""
    pushing.CHUNK = chunk
    with kbstore.open(url, name, read_only=True) as kb:
        dying(killed_at)
        kbstore.push(kb, target)


def killed(act, *arguments):
    """Run a function in a process of its own; return its exit code."""
    process = start(act, *arguments)
    process.join(TOO_LONG)
    return process.exitcode
