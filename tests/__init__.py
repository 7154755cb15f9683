"""Tests of the application; the tree mirrors the packages."""
