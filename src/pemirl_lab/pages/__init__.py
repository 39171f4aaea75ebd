"""Tables, figures and the pages that are made of results files."""
