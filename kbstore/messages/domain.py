"""DomainOperator: an operator as the message describes it."""

from kbstore.messages.base import Message
from kbstore.messages.formulas import DomainAssignment, DomainFormula, DomainInequality


class DomainOperator(Message):
    """An ungrounded operator of the domain.

    The message carries simple conditions and effects only; what it cannot carry (disjunctions, quantifiers,
    conditional effects) is kept in the domain's own `kbstore.domain.Action` of the same name.
    """

    formula: DomainFormula
    at_start_add_effects: tuple[DomainFormula, ...] = ()
    at_start_del_effects: tuple[DomainFormula, ...] = ()
    at_end_add_effects: tuple[DomainFormula, ...] = ()
    at_end_del_effects: tuple[DomainFormula, ...] = ()
    at_start_assign_effects: tuple[DomainAssignment, ...] = ()
    at_end_assign_effects: tuple[DomainAssignment, ...] = ()
    at_start_simple_condition: tuple[DomainFormula, ...] = ()
    over_all_simple_condition: tuple[DomainFormula, ...] = ()
    at_end_simple_condition: tuple[DomainFormula, ...] = ()
    at_start_neg_condition: tuple[DomainFormula, ...] = ()
    over_all_neg_condition: tuple[DomainFormula, ...] = ()
    at_end_neg_condition: tuple[DomainFormula, ...] = ()
    at_start_comparison: tuple[DomainInequality, ...] = ()
    at_end_comparison: tuple[DomainInequality, ...] = ()
    over_all_comparison: tuple[DomainInequality, ...] = ()

    @property
    def name(self) -> str:
        """The operator's name."""
        return self.formula.name
