"""Reports as pages: one HTML file with a row and a section for each part, and the same as JSON beside it."""
