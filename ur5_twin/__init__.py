"""A digital twin of a Universal Robots UR5 cell: see the project's README."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("ur5-twin")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"
