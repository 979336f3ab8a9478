"""DomainOperator: an operator of the domain as a message."""

from collections.abc import Iterable
from typing import Annotated, Any

from kbstore.messages.base import Message, as_list
from kbstore.messages.formulas import DomainAssignment, DomainFormula, DomainInequality

_DomainFormulas = Annotated[tuple[DomainFormula, ...], as_list(DomainFormula)]
_DomainAssignments = Annotated[tuple[DomainAssignment, ...], as_list(DomainAssignment)]
_DomainInequalities = Annotated[tuple[DomainInequality, ...], as_list(DomainInequality)]


class DomainOperator(Message):
    """An ungrounded operator of the domain.

    The message carries simple conditions and effects only; the domain's `kbstore.model.actions.Action` of the same
    name has all of them (disjunctions, quantifiers, conditional effects).
    """

    formula: DomainFormula
    at_start_add_effects: _DomainFormulas = ()
    at_start_del_effects: _DomainFormulas = ()
    at_end_add_effects: _DomainFormulas = ()
    at_end_del_effects: _DomainFormulas = ()
    at_start_assign_effects: _DomainAssignments = ()
    at_end_assign_effects: _DomainAssignments = ()
    at_start_simple_condition: _DomainFormulas = ()
    over_all_simple_condition: _DomainFormulas = ()
    at_end_simple_condition: _DomainFormulas = ()
    at_start_neg_condition: _DomainFormulas = ()
    over_all_neg_condition: _DomainFormulas = ()
    at_end_neg_condition: _DomainFormulas = ()
    at_start_comparison: _DomainInequalities = ()
    at_end_comparison: _DomainInequalities = ()
    over_all_comparison: _DomainInequalities = ()

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        return [(None, self.formula.declaration())]

    @property
    def name(self) -> str:
        """The operator's name."""
        return self.formula.name
