"""The first five minutes: a robot's morning, recorded, and then questioned.

``python -m kbstore.demo [FILE]`` plays the mission of `kbstore.demo.mission` into an SQLite file, and asks the
questions of `kbstore.demo.tour`.
"""
