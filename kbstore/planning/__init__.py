"""Operators: grounded, checked, their effects, and the state that they are expected to lead to; pure."""
