"""Evaluates conditions and expressions at one time and over a span, without a database."""
