"""The report: one offline page and its JSON, built from verdicts and artefacts alone."""
