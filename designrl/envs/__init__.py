"""Gymnasium environments whose body is a design; `import designrl` registers them."""
