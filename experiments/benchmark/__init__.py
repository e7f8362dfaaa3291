"""The benchmark: the speed of regtorch beside other projectors."""
