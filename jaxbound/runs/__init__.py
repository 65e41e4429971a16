"""From a source of recordings to verdicts on a disk: parts, summaries, output folders, fleets."""
