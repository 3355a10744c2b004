"""Cards of input decks as CalculiX reads them: with labels and names of one flat deck."""
