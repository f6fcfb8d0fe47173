"""How good it was: metrics of a replay and the reports that carry them."""
