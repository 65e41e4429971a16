"""Files on a disk: written whole, locked, forced to the disk, and what a run keeps in them."""
