"""PDDL text: reading domains, problems, items and questions, and writing problems."""
