"""Programs of others that assemble decks; the table is the contents page."""
