"""The hidden controller: feedback linearisation, its servo, and the current it asks of the drives."""
