"""Looking at recordings: figures on paper and the Rerun viewer. Both take names, units and colours from ``style``."""
