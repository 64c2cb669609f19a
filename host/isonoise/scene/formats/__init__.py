"""Readers of other formats than Mitsuba 3 XML: each returns a scene dict in Mitsuba 3's vocabulary."""
