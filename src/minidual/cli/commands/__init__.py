"""The commands of this package, one function each."""
