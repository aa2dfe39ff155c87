"""Lets the tests of this folder import `selection_tables` beside them, and gives no test a deadline."""

import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))
settings.register_profile("selection", deadline=None, max_examples=60)  # a busy machine is no fault
settings.load_profile("selection")
