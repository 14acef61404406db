"""Results as tables, figures and films, in the studio, and in the report on one page."""
