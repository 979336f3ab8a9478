"""What kbstore answers, for reading: tables and trees for a terminal (rich), and values for JSON.

The command line and the demonstration show everything through here.
"""
