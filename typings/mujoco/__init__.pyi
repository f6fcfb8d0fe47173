# MuJoCo's bindings are compiled and carry no types; without this, type checkers see an empty module.
from typing import Any

def __getattr__(name: str) -> Any: ...
