"""Helpers of the tests that start real processes."""
