"""The page of the studio: HTML, CSS and JavaScript, without anything from the network."""
