"""The tests of this folder need a planner: ``pip install 'kbstore[planning]' up-kairos``."""

import importlib.util
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import kbstore
from kbstore import KnowledgeBase, ManualClock, seconds
from tests.acceptance.random_problems import WORLDS

pytest.importorskip("unified_planning", reason="unified_planning is not installed: pip install 'kbstore[planning]'")
pytest.importorskip("kairos", reason="the planner kairos is not installed: pip install up-kairos")
up_kairos = pytest.importorskip("up_kairos", reason="the planner up-kairos is not installed")

import unified_planning.shortcuts  # noqa: E402 - only where it is installed

up_kairos.register()
unified_planning.shortcuts.get_environment().credits_stream = None

BEGIN = seconds(1000)
"""The time at which the clock of the tests starts."""


@pytest.fixture
def clock() -> ManualClock:
    """A clock set to `BEGIN`."""
    return ManualClock(BEGIN)


@pytest.fixture
def kb(clock: ManualClock) -> Iterator[KnowledgeBase]:
    """An empty knowledge base in memory; these tests do not depend on the store."""
    with kbstore.open("sqlite://", "loop", clock=clock) as opened:
        yield opened


@pytest.fixture(scope="session")
def courier() -> Any:
    """The example of replanning, as a module."""
    path = Path(__file__).parents[2] / "examples" / "replanning.py"
    spec = importlib.util.spec_from_file_location("replanning", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def load(kb: KnowledgeBase, world: str, seed: int) -> tuple[str, str]:
    """A random problem, loaded; the domain and the problem as kbstore writes them."""
    kb.load(WORLDS[world].domain, WORLDS[world].problem(random.Random(seed)))
    return kb.domain_to_pddl(), kb.to_pddl()
