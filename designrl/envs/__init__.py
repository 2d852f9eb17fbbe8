"""Gymnasium environments whose body is a design; importing this package registers them."""

from designrl.envs.tasks import WORLDS

for _world in WORLDS.values():
    _world.register()
