"""The page that compares rigtool with the thesis: how the project makes its docs/reproduction."""
