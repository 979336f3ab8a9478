"""The command line ``kbstore``: write to knowledge bases, ask them, and maintain their stores."""

from kbstore.cli.app import main

__all__ = ["main"]
