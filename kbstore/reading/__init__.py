"""Answers: the state at a moment, single facts, histories, differences, explanations, the course of a condition."""
