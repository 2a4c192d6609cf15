"""The arm's description files."""
