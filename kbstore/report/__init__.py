"""Answers for people to read: tables and trees for a terminal (rich).

The command line and the demonstration show everything through here.
"""
