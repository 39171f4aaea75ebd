"""What holds for every network: gradients, saved state, copies, the map of observations."""

import copy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from pemirl_trl import modules
from pemirl_trl.modules import (
    ActionCost,
    AIRLDiscriminator,
    AttentionContextEncoder,
    CategoricalPolicy,
    ContextEncoder,
    ContextPolicy,
    ContextValue,
    GAILDiscriminator,
    MaskedContextEncoder,
    NoContext,
    ShapedReward,
    Standardize,
)

N, T, S, A, D = 5, 4, 3, 2, 2

BUILD = {
    "encoder": lambda s: ContextEncoder(S, A, D, T, standardize=s),
    "encoder_with_scale": lambda s: ContextEncoder(
        S, A, D, T, standardize=s, scale_depends_on_input=True
    ),
    "masked_encoder": lambda s: MaskedContextEncoder(S, A, D, standardize=s),
    "attention_encoder": lambda s: AttentionContextEncoder(S, A, D, standardize=s),
    "reward": lambda s: ShapedReward(S, D, standardize=s),
    "discriminator": lambda s: AIRLDiscriminator(ShapedReward(S, D, standardize=s)),
    "gail_discriminator": lambda s: GAILDiscriminator(S, A, standardize=s),
    "policy": lambda s: ContextPolicy(S, A, D, standardize=s),
    "categorical_policy": lambda s: CategoricalPolicy(S, A, D, standardize=s),
    "value": lambda s: ContextValue(S, D, T, standardize=s),
}
# What stands for a module's function in these tests: its differentiable output.
OUTPUTS = {
    "encoder": ("context_loc", "context_scale"),
    "encoder_with_scale": ("context_loc", "context_scale"),
    "masked_encoder": ("context_loc", "context_scale"),
    "reward": ("learned_reward", "shaped_reward"),
    "discriminator": ("logit_expert",),
    "gail_discriminator": ("logit_expert",),
    "attention_encoder": ("context_loc", "context_scale"),
    "policy": ("loc", "scale"),
    "categorical_policy": ("logits",),
    "value": ("state_value",),
}

each_module = pytest.mark.parametrize("name", BUILD)


def batch():
    return TensorDict(
        {
            "observation": torch.randn(N, T, S),
            "action": torch.randn(N, T, A),
            "context": torch.randn(N, T, D),
            "action_log_prob": torch.randn(N, T),
            "next": {"observation": torch.randn(N, T, S)},
        },
        [N],  # an encoder reduces time
    )


def outputs(module, name, inputs):
    result = module(inputs.copy())
    return [result[key] for key in OUTPUTS[name]]


def build(name):
    return BUILD[name](Standardize(torch.randn(S), torch.rand(S) + 0.5))


def test_the_table_lists_every_module():
    exported = {getattr(modules, name) for name in modules.__all__}
    networks = {c for c in exported if issubclass(c, TensorDictModuleBase)}
    # These have no weights and nothing to map: see test_context_encoder.py and test_action_cost.py.
    assert networks == {type(build(name)) for name in BUILD} | {NoContext, ActionCost}


@each_module
def test_every_parameter_gets_a_gradient(name):
    module = build(name)
    weighted = [(o * torch.randn_like(o)).sum() for o in outputs(module, name, batch())]
    sum(weighted).backward()
    for parameter_name, parameter in module.named_parameters():
        assert parameter.grad is not None, parameter_name
        assert parameter.grad.abs().sum() > 0, parameter_name


@each_module
def test_state_moves_to_another_module(name):
    source, target, inputs = build(name), build(name), batch()
    expected = outputs(source, name, inputs)
    target.load_state_dict(source.state_dict())
    for got, value in zip(outputs(target, name, inputs), expected, strict=True):
        assert torch.equal(got, value)


@each_module
def test_a_deep_copy_is_independent(name):
    module, inputs = build(name), batch()
    expected = outputs(module, name, inputs)
    twin = copy.deepcopy(module)
    for got, value in zip(outputs(twin, name, inputs), expected, strict=True):
        assert torch.equal(got, value)
    with torch.no_grad():
        for parameter in twin.parameters():
            parameter.add_(1.0)
    for got, value in zip(outputs(module, name, inputs), expected, strict=True):
        assert torch.equal(got, value)
    assert not torch.equal(outputs(twin, name, inputs)[0], expected[0])


@each_module
def test_the_map_of_observations_is_applied_to_observations(name, float64):
    """A network with a map is the network without, on mapped observations."""
    module, inputs = build(name), batch()
    expected = outputs(module, name, inputs)
    standardize = next(m for m in module.modules() if isinstance(m, Standardize))
    mapped = inputs.copy()
    for key in ("observation", ("next", "observation")):
        mapped[key] = standardize(inputs[key])
    plain = BUILD[name](Standardize.identity(S))
    plain.load_state_dict(
        {k: v for k, v in module.state_dict().items() if "standardize" not in k}, strict=False
    )
    for got, value in zip(outputs(plain, name, mapped), expected, strict=True):
        assert torch.allclose(got, value)


@each_module
def test_a_missing_input_is_named(name):
    module = build(name)
    with pytest.raises(KeyError, match="observation"):
        module(batch().exclude("observation", ("next", "observation")))


@each_module
def test_a_missing_context_is_explained(name):
    module = build(name)
    if "context" in module.in_keys:
        with pytest.raises(KeyError, match=r"'context'.*InferContext writes it at reset"):
            module(batch().exclude("context"))


@each_module
def test_every_key_has_a_name_and_every_name_a_key(name):
    module = build(name)
    named = {value for key, value in vars(module).items() if key.endswith("_key")}
    named |= set(getattr(module, "role_keys", {}).values())
    if name in ("policy", "categorical_policy"):
        named.add(module.log_prob_key)
    assert named == {*module.in_keys, *module.out_keys}


@each_module
def test_float64_by_default_makes_float64_networks_of_float32_data(name, float64):
    module = BUILD[name](Standardize.fit(torch.randn(8, S, dtype=torch.float32)))
    floats = {t.dtype for t in module.state_dict().values() if t.is_floating_point()}
    assert floats == {torch.float64}
    assert {o.dtype for o in outputs(module, name, batch().float())} == {torch.float64}
