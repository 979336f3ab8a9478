"""Results for people, notebooks and web frameworks: short reprs, tables, plain data, response models."""

import json
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from pydantic import TypeAdapter, ValidationError

import kbstore
from kbstore import KnowledgeItem, ManualClock, UpdateType, seconds

NOON = kbstore.time("2026-05-04T12:00:00Z")

DOMAIN = """(define (domain rooms) (:types robot room)
  (:predicates (robot_at ?r - robot ?w - room) (lit ?w - room)) (:functions (battery ?r - robot))
  (:durative-action move :parameters (?r - robot ?to - room) :duration (= ?duration 30)
    :condition (at start (lit ?to)) :effect (at end (robot_at ?r ?to))))"""


@pytest.fixture
def story():
    """Kenny is in the hall, and moves to the lab: two transactions, and a run."""
    clock = ManualClock(NOON)
    with kbstore.open("sqlite://", "kenny", clock=clock) as kb:
        kb.load(DOMAIN)
        kb.add("kenny - robot", "hall - room", "lab - room", "(robot_at kenny hall)", "(= (battery kenny) 80)")
        clock.advance(seconds(1))
        kb.add("(lit lab)", "(not (lit hall))", "(= (battery kenny) 75.5)", client="mapper", note="seen")
        kb.remove("(robot_at kenny hall)")
        kb.add("(lit hall)", initial_time="+1m")
        kb.add_goal("(robot_at kenny lab)")
        kb.add_metric("minimize (total-time)")
        kb.start("move", "kenny", "lab")
        yield kb


# -- reprs --------------------------------------------------------------------------------------------------------


def test_an_item_shows_its_pddl(story):
    """Knowledge and conditions are shown as PDDL, with their initial times."""
    state = story.state()
    assert repr(kbstore.Fact(attribute_name="robot_at", values=["kenny", "hall"])) == "Fact('(robot_at kenny hall)')"
    assert repr(state.facts) == (
        "[Fact('(lit lab)', since='2026-05-04T12:00:01Z'), Fact('(not (lit hall))', since='2026-05-04T12:00:01Z')]"
    )
    assert repr(state.functions[0]) == "Function('(= (battery kenny) 75.5)', since='2026-05-04T12:00:01Z')"
    assert repr(kbstore.item("wp7 - waypoint")) == "Instance('wp7 - waypoint')"
    assert repr(kbstore.item("(> (f) 3)")) == "Inequality('(> (f) 3)')"
    assert repr(kbstore.item("(> (f) 3)").ineq.LHS) == "ExprComposite('(f)')"
    assert repr(kbstore.Condition(text="(or (p) (q))")) == "Condition('(or (p) (q))')"
    assert repr(kbstore.KeyValue("r", "kenny")) == "KeyValue('r', 'kenny')"


def test_a_domain_shows_its_counts(story):
    """Counts, and not a page of signatures."""
    assert repr(story.domain) == "Domain('rooms': 2 types, 2 predicates, 1 function, 1 action)"
    assert repr(story.domain.predicate("lit")) == "DomainFormula('lit', {'w': 'room'})"
    assert repr(story.domain.operator("move")) == "DomainOperator('(move ?r - robot ?to - room)')"


def test_a_state_shows_its_time_and_counts(story):
    """The knowledge base, the time, `as_of`, and the number of items of each kind."""
    assert repr(story.state()) == (
        "State('kenny' at 2026-05-04T12:00:01Z: 3 objects, 2 facts, 1 function, 1 goal, 1 running action)"
    )
    past = story.state("-1s", as_of="-1s")
    assert repr(past) == (
        "State('kenny' at 2026-05-04T12:00:00Z as of 2026-05-04T12:00:00Z: 3 objects, 1 fact, 1 function)"
    )
    assert repr(story.state(0)) == "State('kenny' at 1970-01-01T00:00:00Z: empty)"


def test_a_diff_shows_counts(story):
    """What differs, by kind."""
    assert repr(story.diff("-1s", "now")) == (
        "Diff(1 became true, 1 became false, 1 withdrawn, 1 numbers, 1 goals added, metric)"
    )
    assert repr(story.diff("now", "now")) == "Diff(no difference)"


def test_history_shows_an_assertion_a_line(story):
    """An assertion is its item and its interval."""
    assert repr(story.history("(lit ?)")) == (
        "[Assertion('(lit lab)', since='2026-05-04T12:00:01Z'),\n"
        " Assertion('(not (lit hall))', since='2026-05-04T12:00:01Z', until='2026-05-04T12:01:01Z'),\n"
        " Assertion('(lit hall)', since='2026-05-04T12:01:01Z')]"
    )


def test_transactions_changes_and_runs_are_short(story):
    """Number, time, and the number of changes."""
    changes = list(story.changes(after=2))
    assert repr(changes[0].transaction) == ("Transaction(3 at 2026-05-04T12:00:01Z by 'mapper': 3 changes, 'seen')")
    assert repr(changes[0]) == "Change(3 at 2026-05-04T12:00:01Z: 3 asserted, 1 ended)"
    assert repr(next(story.changes())) == "Change(1 at 2026-05-04T12:00:00Z: domain 'rooms')"
    (run,) = story.state().running
    assert repr(run) == "Run('(move kenny lab)', started='2026-05-04T12:00:01Z', 30 s)"
    assert repr(story.end(run)).startswith("Ended(9 at 2026-05-04T12:00:01Z: 2 changes")
    assert repr(story.explain("(lit lab)")).startswith("Explanation('(lit lab) is true: asserted")
    assert repr(story.applicable("move", "kenny", "hall")).startswith("Applicability((lit hall) is false")


def test_a_change_names_the_domain_that_it_loads(story):
    """Also beside what a problem brings, and for what is made sensed; other changes have no domain."""
    story.set_sensed("lit", True)
    story.load(
        "(define (domain halls) (:types robot room) (:predicates (lit ?w - room)))",
        "(define (problem p) (:domain halls) (:objects attic - room) (:init (lit attic)))",
        replace=True,
    )
    changes = list(story.changes())
    assert [change.domain for change in changes if change.domain] == ["rooms", "rooms", "halls"]
    assert changes[-1].to_dict()["domain"] == "halls"
    assert ": domain 'halls', 2 asserted, " in repr(changes[-1])


# -- tables -------------------------------------------------------------------------------------------------------


def test_notebooks_get_tables(story):
    """State, Diff and history have a table in HTML, in which no quoted text can be markup."""
    shown = story.state()._repr_html_()
    assert "<td>(lit lab)</td><td>2026-05-04T12:00:01Z</td>" in shown
    assert "(move kenny lab)" in shown
    assert "<td>(battery kenny) 80 -&gt; 75.5</td>" in story.diff("-1s", "now")._repr_html_()
    assert "<td>(not (lit hall))</td>" in story.history("(lit ?)")._repr_html_()
    with kbstore.open("sqlite://") as kb:
        kb.add(kbstore.Fact(attribute_name="p<script>"))
        assert (
            "<script>"
            not in kb.state()._repr_html_() + kb.history(kbstore.Fact(attribute_name="p<script>"))._repr_html_()
        )


def test_a_long_table_is_cut():
    """A state of thousands of facts does not fill the notebook."""
    with kbstore.open("sqlite://") as kb:
        kb.add(*(f"(p a{n})" for n in range(250)))
        shown = kb.state()._repr_html_()
    assert "facts (250)" in shown
    assert "and 50 more" in shown
    assert shown.count("<td>(p ") == 200


# -- plain data ---------------------------------------------------------------------------------------------------


def results(kb):
    """One of each result."""
    run = kb.state().running[0]
    return [
        kb.state(),
        kb.add("(lit hall)"),
        kb.history("(lit ?)")[0],
        list(kb.changes())[-1],
        kb.diff("-1s", "now"),
        kb.query("(lit hall)", "(robot_at kenny hall)"),
        kb.explain("(and (lit hall) (robot_at kenny hall))"),
        kb.applicable("move", "kenny", "hall"),
        run,
        kb.end(run),
    ]


def test_every_result_is_plain_data(story):
    """`to_dict` of each result goes through JSON and comes back the same; no objects are in it."""
    for found in results(story):
        data = found.to_dict()
        assert json.loads(json.dumps(data)) == data


def test_times_come_as_text_and_as_nanoseconds(story):
    """Both are exact."""
    data = story.state().to_dict()
    assert (data["at"], data["at_ns"], data["as_of"]) == ("2026-05-04T12:00:01Z", NOON + seconds(1), None)
    assert data["facts"][0]["pddl"] == "(lit lab)"
    assert kbstore.item(data["facts"][0]["item"]) == story.state().facts[0]
    (run,) = data["running"]
    assert (run["operator"], run["arguments"], run["number"], run["duration_ns"]) == (
        "move",
        ["kenny", "lab"],
        1,
        seconds(30),
    )
    assert (run["started"], run["started_ns"]) == ("2026-05-04T12:00:01Z", NOON + seconds(1))
    assert (run["expected_end"], run["expected_end_ns"]) == ("2026-05-04T12:00:31Z", NOON + seconds(31))
    assert story.when("(lit lab)", "-1m", "now").to_dict() == []
    assert story.when("(lit lab)", "now", "+1s").to_dict() == [
        {
            "start": "2026-05-04T12:00:01Z",
            "start_ns": NOON + seconds(1),
            "end": "2026-05-04T12:00:02Z",
            "end_ns": NOON + seconds(2),
        }
    ]
    (found,) = story.history("(robot_at kenny hall)").to_dict()
    assert (found["pddl"], found["initial_ns"], found["end_ns"]) == (
        "(robot_at kenny hall)",
        NOON,
        NOON + seconds(1),
    )
    assert (found["recorded"]["number"], found["ended"]["number"], found["cancelled"]) == (2, 4, None)


# -- a web service ------------------------------------------------------------------------------------------------


def test_results_are_response_models(story):
    """Pydantic reads each dataclass back from its JSON: they can be declared as responses of a service."""
    for found in results(story)[1:]:
        adapter = TypeAdapter(type(found))
        assert adapter.validate_json(adapter.dump_json(found)) == found
        assert "title" in str(adapter.json_schema())


def test_lists_of_results_are_response_models(story):
    """Histories and intervals are written as lists of their parts, and read back as what they were."""
    for found in (story.history("(lit ?)"), story.when("(lit lab)", "now", "+1s")):
        assert found
        adapter = TypeAdapter(type(found))
        again = adapter.validate_json(adapter.dump_json(found))
        assert (type(again), again) == (type(found), found)
        assert adapter.json_schema()["type"] == "array"


def test_a_state_is_a_response_model(story):
    """A state is written as its parts, which the schema names; Pydantic takes nothing else for one."""
    state = story.state()
    adapter = TypeAdapter(kbstore.State)
    written = adapter.dump_python(state, mode="json")
    for part, type_ in (
        ("facts", list[kbstore.Fact]),
        ("functions", list[kbstore.Function]),
        ("instances", list[kbstore.Instance]),
        ("goals", list[kbstore.Fact]),
        ("metric", kbstore.Expression),
        ("timed_knowledge", list[KnowledgeItem]),
        ("running", list[kbstore.Run]),
    ):
        found = TypeAdapter(type_).validate_python(written[part])
        assert found
        assert found == getattr(state, part)
    assert (written["name"], written["at"], written["as_of"]) == ("kenny", NOON + seconds(1), None)
    assert adapter.validate_python(state) is state
    for schema in (adapter.json_schema(), adapter.json_schema(mode="serialization")):
        assert (schema["title"], schema["type"]) == ("State", "object")
        assert schema["properties"].keys() == written.keys()
    with pytest.raises(ValidationError, match="instance of State"):
        adapter.validate_python(written)


def test_a_state_has_parts_but_is_not_iterated(story):
    """`dict(state)` has the parts; a state is no list of facts, and an unknown part is a KeyError."""
    state = story.state()
    assert dict(state)["facts"] == state.facts
    for wrong in (iter, list, lambda state: "(lit lab)" in state):
        with pytest.raises(TypeError, match="State"):
            wrong(state)
    with pytest.raises(KeyError, match="fact"):
        state["fact"]


@pytest.fixture
def service(story):
    """A service over the knowledge base, as in its documentation."""
    app = FastAPI()

    @app.post("/items", response_model=kbstore.Transaction)
    def add(items: list[KnowledgeItem]) -> kbstore.Transaction:
        return story.update([(UpdateType.ADD_KNOWLEDGE, item) for item in items])

    @app.get("/history", response_model=list[kbstore.Assertion])
    def history(pattern: str) -> list[kbstore.Assertion]:
        return story.history(pattern)

    @app.get("/diff", response_model=kbstore.Diff)
    def diff(since: str) -> kbstore.Diff:
        return story.diff(since, "now")

    @app.get("/state")
    def state() -> dict[str, Any]:
        return story.state().to_dict()

    return TestClient(app)


def test_a_service_takes_items_and_answers_with_results(story, service):
    """FastAPI: a body of items, results as response models, a state as a dict."""
    items = [
        story.state().functions[0].model_dump(mode="json"),
        kbstore.item("(lit hall)", story.domain).model_dump(mode="json"),
    ]
    answer = service.post("/items", json=items).json()
    assert (answer["number"], answer["changes"]) == (9, 1)
    assert service.get("/state").json() == json.loads(json.dumps(story.state().to_dict()))
    history = service.get("/history", params={"pattern": "(lit hall)"}).json()
    assert TypeAdapter(list[kbstore.Assertion]).validate_python(history) == story.history("(lit hall)")
    diff = service.get("/diff", params={"since": "-1s"}).json()
    assert TypeAdapter(kbstore.Diff).validate_python(diff) == story.diff("-1s", "now")


def test_a_service_names_the_one_field_that_is_wrong(service):
    """FastAPI answers 422, with the position in the body; OpenAPI has the discriminator."""
    answer = service.post("/items", json=[{"knowledge_type": 1, "attribute_name": "lit", "values": [{"key": 3}]}])
    assert answer.status_code == 422
    assert [error["loc"] for error in answer.json()["detail"]] == [["body", 0, 1, "values", 0, "key"]]
    body = service.app.openapi()["paths"]["/items"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    assert body["items"]["discriminator"]["propertyName"] == "knowledge_type"
