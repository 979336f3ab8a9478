"""Random stories with late knowledge, pushed in random portions: the copy agrees with the naive reference.

After the story the copy is asked everything that is compared about a knowledge base: every state as of every time and
transaction, the histories, the changes and the differences (L1 to L9, T5, Q1 to Q6).
"""

from hypothesis import given, settings
from hypothesis import strategies as st

import kbstore
from kbstore.storage.engine import make_engine
from kbstore.transfer import push as pushing
from tests.property.test_late import LateAgreement, stories
from tests.property.test_model import EXAMPLES, SETTINGS


@settings(SETTINGS, max_examples=EXAMPLES or 8)
@given(
    use_unknowns=st.booleans(),
    with_domain=st.sampled_from([True, True, False]),
    story=stories,
    portions=st.sets(st.integers(0, 13), max_size=4),
    chunk=st.sampled_from([1, 3, 10_000]),
)
def test_a_copy_answers_as_the_reference(monkeypatch, use_unknowns, with_domain, story, portions, chunk):
    """Q1 to Q6: after any story, pushed in any portions."""
    monkeypatch.setattr(pushing, "CHUNK", chunk)
    source, target = make_engine("sqlite://"), make_engine("sqlite://")
    both = LateAgreement(lambda **options: kbstore.open(source, "kenny", **options), reopens=False)
    both.begin(use_unknowns, with_domain, furnished=True)
    for number, (tick, steps) in enumerate(story):
        both.update(tick, steps)
        if number in portions:
            kbstore.push(both.kb, target)
    kbstore.push(both.kb, target)
    both.kb.close()
    both.kb = kbstore.open(target, both.name, clock=both.clock, read_only=True)
    both.teardown()
    for engine in (source, target):
        engine.dispose()
