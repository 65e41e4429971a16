"""Pictures of results. They take results, never the other way round. Each file registers with `plot` what it
draws, and `every` imports them all.
"""
