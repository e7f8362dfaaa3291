"""Studies: each file runs one from its configuration in conf/, or draws its figures from the table alone."""
