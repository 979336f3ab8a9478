"""Answers of a PostgreSQL server that an interrupt cuts off are not read as answers to the next statement."""

import pytest

import kbstore


@pytest.mark.parametrize("in_pipeline", [False, True])
def test_a_connection_that_waits_for_an_answer_does_not_go_back_to_the_pool(postgresql_url, in_pipeline):
    """Ctrl-C may come between sending a statement and reading its answer."""
    with kbstore.open(postgresql_url, f"cut off {in_pipeline}") as kb:
        kb.add("(open hall)")
        with kb._database.connect() as connection:
            protocol = connection.driver.pgconn
            if in_pipeline:
                protocol.enter_pipeline_mode()
            protocol.send_query_params(b"SELECT 1", None)
        assert kb.holds("(open hall)")
        assert kb.add("(open lab)").number == 2
        assert len(kb.state().facts) == 2
