"""Pictures of the studies, from results alone."""
