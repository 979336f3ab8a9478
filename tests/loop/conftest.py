"""The tests of this folder need a planner: ``pip install 'kbstore[planning]' up-kairos``."""

import pytest

pytest.importorskip("unified_planning", reason="unified_planning is not installed: pip install 'kbstore[planning]'")
pytest.importorskip("kairos", reason="the planner kairos is not installed: pip install up-kairos")
up_kairos = pytest.importorskip("up_kairos", reason="the planner up-kairos is not installed")

import unified_planning.shortcuts  # noqa: E402 - only where it is installed

up_kairos.register()
unified_planning.shortcuts.get_environment().credits_stream = None
