"""kbstore: a bitemporal knowledge base for robot planning on SQLite and PostgreSQL.

Begin with `kbstore.open`. A name is imported when it is first used, so that a program that needs a part of kbstore does
not wait for all of it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kbstore.api import knowledge_bases, open, push
    from kbstore.clock import Clock, DurationLike, ManualClock, SystemClock, TimeLike, seconds, time
    from kbstore.conversion import MessageDomain as Domain
    from kbstore.errors import (
        ClockJumped,
        ClockWentBackwards,
        Conflict,
        DivisionByZero,
        HistoryUnavailable,
        InvalidKnowledge,
        InvalidTime,
        KbStoreError,
        MissingLibrary,
        NotApplicable,
        NotLinear,
        PddlSyntaxError,
        ScheduledRelativeChange,
        SchemaOutOfDate,
        SchemaTooNew,
        SchemaUnknown,
        StoreUnavailable,
        StoreWentBack,
        UndefinedFunction,
        UnknownSymbol,
    )
    from kbstore.knowledge_base import KnowledgeBase
    from kbstore.messages import (
        AssignOp,
        ComparisonType,
        Condition,
        DomainAssignment,
        DomainFormula,
        DomainInequality,
        DomainOperator,
        ExprBase,
        ExprComposite,
        Expression,
        ExprType,
        Fact,
        Function,
        Inequality,
        Instance,
        KeyValue,
        KnowledgeItem,
        KnowledgeType,
        Operator,
        SpecialType,
        Truth,
        UpdateType,
    )
    from kbstore.model.assertions import Assertions
    from kbstore.model.results import (
        Applicability,
        Assertion,
        Broken,
        Change,
        Diff,
        Ended,
        Explanation,
        QueryResult,
        Run,
        Transaction,
    )
    from kbstore.pddl.strict_names import StrictPddl
    from kbstore.reading.questions import Knowledge, Question, item
    from kbstore.reading.state import State
    from kbstore.transfer.archive import Archived
    from kbstore.transfer.backup import backup
    from kbstore.transfer.interchange import export_knowledge_base, import_knowledge_base
    from kbstore.transfer.push import Pushed
    from kbstore.writing.ingesting import Ingested
    from kbstore.writing.unit_of_work import OpenTransaction

__all__ = [
    "Applicability",
    "Archived",
    "Assertion",
    "Assertions",
    "AssignOp",
    "Broken",
    "Change",
    "Clock",
    "ClockJumped",
    "ClockWentBackwards",
    "ComparisonType",
    "Condition",
    "Conflict",
    "Diff",
    "DivisionByZero",
    "Domain",
    "DomainAssignment",
    "DomainFormula",
    "DomainInequality",
    "DomainOperator",
    "DurationLike",
    "Ended",
    "Explanation",
    "ExprBase",
    "ExprComposite",
    "ExprType",
    "Expression",
    "Fact",
    "Function",
    "HistoryUnavailable",
    "Inequality",
    "Ingested",
    "Instance",
    "InvalidKnowledge",
    "InvalidTime",
    "KbStoreError",
    "KeyValue",
    "Knowledge",
    "KnowledgeBase",
    "KnowledgeItem",
    "KnowledgeType",
    "ManualClock",
    "MissingLibrary",
    "NotApplicable",
    "NotLinear",
    "OpenTransaction",
    "Operator",
    "PddlSyntaxError",
    "Pushed",
    "QueryResult",
    "Question",
    "Run",
    "ScheduledRelativeChange",
    "SchemaOutOfDate",
    "SchemaTooNew",
    "SchemaUnknown",
    "SpecialType",
    "State",
    "StoreUnavailable",
    "StoreWentBack",
    "StrictPddl",
    "SystemClock",
    "TimeLike",
    "Transaction",
    "Truth",
    "UndefinedFunction",
    "UnknownSymbol",
    "UpdateType",
    "backup",
    "export_knowledge_base",
    "import_knowledge_base",
    "item",
    "knowledge_bases",
    "open",
    "push",
    "seconds",
    "time",
]

_HOMES = {
    "knowledge_bases": "kbstore.api.knowledge_bases",
    "open": "kbstore.api.open",
    "push": "kbstore.api.push",
    "Clock": "kbstore.clock.Clock",
    "DurationLike": "kbstore.clock.DurationLike",
    "ManualClock": "kbstore.clock.ManualClock",
    "SystemClock": "kbstore.clock.SystemClock",
    "TimeLike": "kbstore.clock.TimeLike",
    "seconds": "kbstore.clock.seconds",
    "time": "kbstore.clock.time",
    "Domain": "kbstore.conversion.MessageDomain",
    "ClockJumped": "kbstore.errors.ClockJumped",
    "ClockWentBackwards": "kbstore.errors.ClockWentBackwards",
    "Conflict": "kbstore.errors.Conflict",
    "DivisionByZero": "kbstore.errors.DivisionByZero",
    "HistoryUnavailable": "kbstore.errors.HistoryUnavailable",
    "InvalidKnowledge": "kbstore.errors.InvalidKnowledge",
    "InvalidTime": "kbstore.errors.InvalidTime",
    "KbStoreError": "kbstore.errors.KbStoreError",
    "MissingLibrary": "kbstore.errors.MissingLibrary",
    "NotApplicable": "kbstore.errors.NotApplicable",
    "NotLinear": "kbstore.errors.NotLinear",
    "PddlSyntaxError": "kbstore.errors.PddlSyntaxError",
    "ScheduledRelativeChange": "kbstore.errors.ScheduledRelativeChange",
    "SchemaOutOfDate": "kbstore.errors.SchemaOutOfDate",
    "SchemaTooNew": "kbstore.errors.SchemaTooNew",
    "SchemaUnknown": "kbstore.errors.SchemaUnknown",
    "StoreUnavailable": "kbstore.errors.StoreUnavailable",
    "StoreWentBack": "kbstore.errors.StoreWentBack",
    "UndefinedFunction": "kbstore.errors.UndefinedFunction",
    "UnknownSymbol": "kbstore.errors.UnknownSymbol",
    "KnowledgeBase": "kbstore.knowledge_base.KnowledgeBase",
    "AssignOp": "kbstore.messages.AssignOp",
    "ComparisonType": "kbstore.messages.ComparisonType",
    "Condition": "kbstore.messages.Condition",
    "DomainAssignment": "kbstore.messages.DomainAssignment",
    "DomainFormula": "kbstore.messages.DomainFormula",
    "DomainInequality": "kbstore.messages.DomainInequality",
    "DomainOperator": "kbstore.messages.DomainOperator",
    "ExprBase": "kbstore.messages.ExprBase",
    "ExprComposite": "kbstore.messages.ExprComposite",
    "Expression": "kbstore.messages.Expression",
    "ExprType": "kbstore.messages.ExprType",
    "Fact": "kbstore.messages.Fact",
    "Function": "kbstore.messages.Function",
    "Inequality": "kbstore.messages.Inequality",
    "Instance": "kbstore.messages.Instance",
    "KeyValue": "kbstore.messages.KeyValue",
    "KnowledgeItem": "kbstore.messages.KnowledgeItem",
    "KnowledgeType": "kbstore.messages.KnowledgeType",
    "Operator": "kbstore.messages.Operator",
    "SpecialType": "kbstore.messages.SpecialType",
    "Truth": "kbstore.messages.Truth",
    "UpdateType": "kbstore.messages.UpdateType",
    "Applicability": "kbstore.model.results.Applicability",
    "Assertion": "kbstore.model.results.Assertion",
    "Assertions": "kbstore.model.assertions.Assertions",
    "Broken": "kbstore.model.results.Broken",
    "Change": "kbstore.model.results.Change",
    "Diff": "kbstore.model.results.Diff",
    "Ended": "kbstore.model.results.Ended",
    "Explanation": "kbstore.model.results.Explanation",
    "QueryResult": "kbstore.model.results.QueryResult",
    "Run": "kbstore.model.results.Run",
    "Transaction": "kbstore.model.results.Transaction",
    "StrictPddl": "kbstore.pddl.strict_names.StrictPddl",
    "Knowledge": "kbstore.reading.questions.Knowledge",
    "Question": "kbstore.reading.questions.Question",
    "item": "kbstore.reading.questions.item",
    "State": "kbstore.reading.state.State",
    "Archived": "kbstore.transfer.archive.Archived",
    "backup": "kbstore.transfer.backup.backup",
    "export_knowledge_base": "kbstore.transfer.interchange.export_knowledge_base",
    "import_knowledge_base": "kbstore.transfer.interchange.import_knowledge_base",
    "Pushed": "kbstore.transfer.push.Pushed",
    "Ingested": "kbstore.writing.ingesting.Ingested",
    "OpenTransaction": "kbstore.writing.unit_of_work.OpenTransaction",
}
"""The place of each public name at run time; type checkers read the imports above."""


def __getattr__(name: str) -> Any:
    """Import a public name, or a module of kbstore, when it is first used."""
    if name in _HOMES:
        module, _, own = _HOMES[name].rpartition(".")
        found = globals()[name] = getattr(import_module(module), own)
        return found
    if not name.startswith("_"):
        try:
            return import_module(f"kbstore.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"kbstore.{name}":
                raise
    raise AttributeError(f"kbstore has no name {name!r}", name=name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
