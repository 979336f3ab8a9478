"""Draws a history: one self-contained page for a browser, and lanes of text for a terminal."""
