"""The command line ``kbstore``: everything that a knowledge base can be told and asked, and the care of its store."""

from kbstore.cli.app import main

__all__ = ["main"]
