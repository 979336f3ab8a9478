"""Answers questions: states at a time, single facts, histories, differences, explanations, when a condition held."""
