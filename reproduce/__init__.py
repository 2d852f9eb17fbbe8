"""One readable script per table and figure of the paper; run them as `python -m reproduce.NAME`."""
