"""How the tests of the rules read answers: as sorted PDDL text."""


def texts(items):
    """Items as sorted PDDL text."""
    return sorted(str(item) for item in items)


def facts(kb, at=None, **belief):
    """The facts of both signs that hold at a time."""
    return texts(kb.state(at, **belief).facts)


def instances(kb, at=None, **belief):
    """The objects that exist at a time, with their types."""
    return texts(kb.state(at, **belief).instances)


def scheduled(kb, at=None, **belief):
    """The timed knowledge: pairs of time and PDDL text."""
    return sorted((item.initial_time, str(item)) for item in kb.state(at, **belief).timed_knowledge)


def picture(kb, at=None, **belief):
    """All content of a state, for comparing one answer with another."""
    state = kb.state(at, **belief)
    return {
        "instances": texts(state.instances),
        "facts": texts(state.facts),
        "functions": texts(state.functions),
        "inequalities": texts(state.inequalities),
        "metric": str(state.metric),
        "goals": texts(state.goals),
        "timed_knowledge": sorted((item.initial_time, str(item)) for item in state.timed_knowledge),
        "domain": state.domain.name if state.domain else None,
    }


def intervals(kb, pattern, **span):
    """The history of a pattern: PDDL text, initial time, end time, and whether it was cancelled."""
    return [(str(a.item), a.initial_time, a.end_time, a.cancelled is not None) for a in kb.history(pattern, **span)]
