"""`dbw dashboard`: what is shown, who may do what, and the server of the page."""
