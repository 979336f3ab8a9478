"""The PDDL model: formulas, actions, domains, timelines, and the results of questions."""
