"""A pytest plugin: the file that the environment names takes the place of a module of ours.

INSTEAD=FILE pytest -p tests.mutation.instead ...
"""

from __future__ import annotations

import importlib.util
import os
import sys

import dbc
from tests.mutation.spec import NAME

where = importlib.util.spec_from_file_location(NAME, os.environ["INSTEAD"])
assert where is not None
assert where.loader is not None
assert NAME not in sys.modules, "what has it already would keep the right one"
module = importlib.util.module_from_spec(where)
sys.modules[NAME] = dbc.spec = module
where.loader.exec_module(module)
