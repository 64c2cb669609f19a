"""What Jupyter shows of renders, and their progress there. Nothing of it is imported unless something is shown."""
