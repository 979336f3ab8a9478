"""The demonstration: a robot's morning, recorded, and questions about it.

``python -m kbstore.demo [FILE]`` records the mission of `kbstore.demo.mission` in an SQLite file, and asks the
questions of `kbstore.demo.tour`.
"""
