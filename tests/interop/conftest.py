"""The tests of this folder need the extra ``planning``."""

import pytest

pytest.importorskip("unified_planning", reason="unified_planning is not installed: pip install 'kbstore[planning]'")
