"""Pictures of results. They take results, never the other way round."""
