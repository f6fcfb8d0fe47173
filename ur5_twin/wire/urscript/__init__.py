"""URScript, the robot's language; of the robot itself it knows nothing.

lexer, parser    text -> syntax
syntax           what a program consists of
values           numbers, lists, poses, strings, and what may be done with them
compiler         syntax -> closures
interpreter      the program's threads, a tick at a time
library/         functions that need no robot
costs            what functions take of a thread's time
limits           how much a program may have of everything
"""

from ur5_twin.wire.urscript.costs import costs
from ur5_twin.wire.urscript.interpreter import Interpreter
from ur5_twin.wire.urscript.library import library
from ur5_twin.wire.urscript.parser import parse
from ur5_twin.wire.urscript.values import Pose, shown

__all__ = ["Interpreter", "Pose", "costs", "library", "parse", "shown"]
