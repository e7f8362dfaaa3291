"""The paper's simulation study: random geometries about one default, registered from there."""
