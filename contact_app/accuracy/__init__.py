"""Accuracy of an answer: when an estimate of its error may be believed."""
