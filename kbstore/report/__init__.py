"""Answers for people: tables and trees for a terminal (rich), timelines, and the record as tables for other tools."""
