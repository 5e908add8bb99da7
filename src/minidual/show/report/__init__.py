"""The report: one offline page, its JSON and its figures."""
