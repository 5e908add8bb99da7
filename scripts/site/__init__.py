"""The documentation site: `make docs` builds it offline into build/site."""
