"""Interfaces for programs that are not Python, each behind an extra of its own."""
