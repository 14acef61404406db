"""What is shown of results: tables, figures, films, the studio, the report on one page."""
