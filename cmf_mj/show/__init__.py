"""Results as tables, figures and pages that play runs."""
