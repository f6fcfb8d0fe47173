"""Where the twin's samples come from."""
