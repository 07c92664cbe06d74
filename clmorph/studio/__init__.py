"""The studio: a local web page on which two pictures become one another."""
