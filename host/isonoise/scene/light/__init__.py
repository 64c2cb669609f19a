"""Emitters as device records, and the structures that next-event estimation selects them by."""
