"""The 2014 report: its models and results, what fits them, its ledger and its page."""
