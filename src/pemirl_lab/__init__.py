"""The experiments: commands with YAML, run folders, experts, scoring, tables and pages.

``pemirl --help`` lists the commands. The learning is in :mod:`pemirl_trl`, the tasks are in
:mod:`pemirl_envs`; this package knows both, and Hydra.
"""
