"""The study of the search: how often it finds the place from far off, and whether its verdict knows."""
