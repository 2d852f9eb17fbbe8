"""The policy network in torch, for gradients and batches; rollouts use `designrl.policy`."""

import torch

from designrl.experiments import Network
from designrl.policy import split_layers


class TanhPolicy(torch.nn.Module):
    """The network in torch: (..., O) observations -> (..., A) mean actions.

    `torch.nn.utils.parameters_to_vector(policy.parameters())` is the flat vector, without the
    design; `vector_to_parameters` loads one.
    """

    def __init__(self, network: Network, dtype: torch.dtype = torch.float64):
        super().__init__()
        self.network = network
        views = split_layers(network, torch.zeros(network.num_parameters, dtype=dtype))
        self.layers = torch.nn.ParameterList(view.clone() for view in views)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Mean action; the time input, if the network has one, is the observation's last."""
        x = observation
        count = len(self.network.sizes) - 1
        for i in range(count):
            x = x @ self.layers[2 * i] + self.layers[2 * i + 1]
            if i < count - 1 or self.network.output == "tanh":
                x = torch.tanh(x)
        return x
