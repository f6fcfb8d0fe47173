"""Write the MJCF files that ship: ``python -m ur5_twin.arm.mjcf``."""

from __future__ import annotations

import argparse

from ur5_twin.arm.mjcf.export import write_models
from ur5_twin.resources import data_dir


def main() -> None:
    """Write every shipped model into a folder."""
    parser = argparse.ArgumentParser(prog="python -m ur5_twin.arm.mjcf", description=__doc__)
    parser.add_argument("--folder", default=data_dir("models"), help="where to write (default: the models folder)")
    for path in write_models(parser.parse_args().folder):
        print(path.name)


main()
