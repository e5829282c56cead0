"""From notebooks to pages: runs, provenance, result tables, scorecard, figures and the site."""
