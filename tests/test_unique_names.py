"""Distinct names for objects and files."""

from isonoise.scene.unique_names import UniqueNames


def test_names_that_were_given_are_numbered():
    names = UniqueNames()
    assert [names.add(name) for name in ("a", "a_2", "a", "a_2", "A", "a")] == ["a", "a_2", "a_3", "a_2_2", "A", "a_4"]


def test_case_may_be_ignored():
    names = UniqueNames(ignore_case=True)
    assert [names.add(name, ".ply") for name in ("a", "A", "a")] == ["a.ply", "A_2.ply", "a_3.ply"]
    assert names.add("a", ".png") == "a.png"
