"""The compiled engine beside the reference environments; `python -m designrl.verify` compares."""
