"""What is shown of a render while it runs: a web page on loopback, and the viewer tev."""
