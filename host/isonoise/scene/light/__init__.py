"""Compiles emitters to device records, and builds the structures that select lights for next-event estimation."""
