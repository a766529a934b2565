"""`rig workspace`: what the tip can reach."""

from __future__ import annotations

from rig.cli.options import AsJson, DrawingFile, Replace, RigName, Variant


def workspace(
    rig: RigName = None, model: Variant = None, to: DrawingFile = None, replace: Replace = False, json: AsJson = False
) -> None:
    """Show what the tip of a rig can reach at rest; --to FILE.png, .pdf or .svg draws it."""

    from rig.cli import workspace_output
    from rig.cli.output import console, print_json
    from rig.config.loader import chosen_rig, load
    from rig.config.sections import variant_named

    if to is not None:
        workspace_output.check_drawing(to, replace)
    config = load(chosen_rig(rig).name)
    variant = variant_named(model)
    from rig.tip_planning.workspace import workspace as sampled

    space = sampled(config, variant)
    if to is not None:
        workspace_output.save(space, to)
    if json:
        print_json(workspace_output.facts(space, config))
        return
    console().print(workspace_output.table(space, config))
    if to is not None:
        console().print(f"drawing  {to}", soft_wrap=True)
