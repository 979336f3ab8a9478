"""Operators: grounding, applicability, effects, and the states that they are expected to lead to; no database."""
