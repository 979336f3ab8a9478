"""The demonstration: a robot's morning, recorded, and questions about it.

``python -m kbstore.cli.demo [FILE]`` records the mission of `kbstore.cli.demo.mission` in an SQLite file, and asks the
questions of `kbstore.cli.demo.tour`.
"""
