"""Reports: tables beside the published ones, figures, one HTML page."""
