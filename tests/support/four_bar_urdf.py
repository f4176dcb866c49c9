"""A four-bar as a URDF, and its closures and motor in several dialects."""


def link(name: str, mass: float = 0.5, *, visual: str = "") -> str:
    inertia = f'<inertia ixx="{mass / 100}" iyy="{mass / 100}" izz="{mass / 100}" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><origin xyz="0 0 0.05"/><mass value="{mass}"/>{inertia}</inertial>' if mass else ""
    return f'<link name="{name}">{inertial}{visual}</link>'


def joint(name: str, parent: str, child: str, xyz: str, *, kind: str = "revolute", axis: str = "0 1 0") -> str:
    limit = '<limit lower="-3" upper="3" effort="7" velocity="20"/>' if kind == "revolute" else ""
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="{axis}"/>{limit}</joint>'


FOUR_BAR = "".join(
    [
        link("base"),
        link("crank"),
        link("coupler"),
        link("rocker"),
        joint("motor", "base", "crank", "0 0 0"),
        joint("A", "crank", "coupler", "0 0 0.1"),
        joint("C", "base", "rocker", "0.2 0 0"),
    ]
)
FRAMES = "".join(
    [
        link("end_A", 0.0),
        link("end_B", 0.0),
        joint("end_A_frame", "coupler", "end_A", "0.2 0 0.05", kind="fixed"),
        joint("end_B_frame", "rocker", "end_B", "0 0 0.15", kind="fixed"),
    ]
)
ENDS = {"coupler": "0.2 0 0.05", "rocker": "0 0 0.15"}
TRANSMISSION = '<transmission name="t"><joint name="motor"/><actuator name="m"/></transmission>'
LOOP_JOINT = (
    '<loop_joint name="B" type="continuous"><link1 link="coupler" xyz="0.2 0 0.05" rpy="0 0 0"/>'
    '<link2 link="rocker" xyz="0 0 0.15" rpy="0 0 0"/><axis xyz="0 1 0"/></loop_joint>'
)
YAML = "closed_loop: [['end_A', 'end_B']]\ntype: ['3d']\nname_mot: ['motor']\n"


def robot(*parts: str) -> str:
    return f'<robot name="four-bar">{"".join(parts)}</robot>'


def written(folder, text: str, yaml: str | None = None) -> str:
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    if yaml is not None:
        (folder / "robot.yaml").write_text(yaml, encoding="utf-8")
    return str(folder / "robot.urdf")


CUT = "closures: [{link_a: coupler, link_b: rocker, point: [0.2, 0, 0.15], axis: [0, 2, 0]}]\nindependent: [motor]\n"
