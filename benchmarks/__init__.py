"""Benchmarks of kbstore against raw SQL on the same rows, ideally laid out, and against its peers.

``make bench`` prints one table. What is compared is measured side by side in one run, in turns, and reported as a ratio
of lower quartiles: other work on the machine slows both sides alike.
"""
