"""That this file is here puts `tests/sets` on the path: the rooms below share its corners and cases."""
