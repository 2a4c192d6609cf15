"""Offline commands."""
