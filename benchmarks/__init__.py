"""Measurements of kbstore against the limit (raw SQL on the same rows, laid out ideally) and against its peers.

``make bench`` prints one table. What is compared is measured side by side in one run, in turns, and told as a ratio of
lower quartiles: other work on the machine slows both sides alike.
"""
