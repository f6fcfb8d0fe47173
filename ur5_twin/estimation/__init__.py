"""Estimators of the wrench on the arm, from a nominal model and what a real robot publishes, never the truth."""

from __future__ import annotations

from ur5_twin.estimation.nominal import NominalModel, load_nominal
from ur5_twin.estimation.protocol import Estimate, Estimator, Sample
from ur5_twin.estimation.registry import create, estimator_names
from ur5_twin.estimation.samples import Estimates, estimate, samples_of

__all__ = [
    "Estimate",
    "Estimates",
    "Estimator",
    "NominalModel",
    "Sample",
    "create",
    "estimate",
    "estimator_names",
    "load_nominal",
    "samples_of",
]
