"""A transfer table as a C++ header for a ros2_control plugin: interpolation, both directions, no dependencies."""

import numpy as np

from linkplan.studies.handover.export.c_source import identifier
from linkplan.studies.handover.transfer.study import Transfer

_CLASS = """
constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();
{data}

/// The linkage at one position of its joints: call at() once in every control cycle, then carry what is needed.
class Transmission {{
 public:
  /// Interpolate the table. Returns false off the map; nothing may be carried then.
  bool at(const double joint_position[kJoints])
  {{
    int below[kJoints];
    double share[kJoints];
    for (int i = 0; i < kJoints; ++i) {{
      const double *axis = kAxes[i];
      if (!(joint_position[i] >= axis[0] && joint_position[i] <= axis[kNodes[i] - 1])) return false;
      int low = 0, high = kNodes[i] - 1;
      while (high - low > 1) {{
        const int middle = (low + high) / 2;
        if (axis[middle] <= joint_position[i]) low = middle; else high = middle;
      }}
      below[i] = low;
      share[i] = (joint_position[i] - axis[low]) / (axis[low + 1] - axis[low]);
    }}
    double sum[kRow] = {{}};
    for (int corner = 0; corner < (1 << kJoints); ++corner) {{
      double weight = 1.0;
      int node = 0;
      for (int i = 0; i < kJoints; ++i) {{
        const int up = (corner >> i) & 1;
        weight *= up ? share[i] : 1.0 - share[i];
        node = node * kNodes[i] + below[i] + up;
      }}
      if (weight == 0.0) continue;
      for (int k = 0; k < kRow; ++k) sum[k] += weight * kTable[node][k];
    }}
    for (int k = 0; k < kRow; ++k) if (!(sum[k] == sum[k])) return false;
    for (int j = 0; j < kMotors; ++j) motor_position_[j] = sum[j];
    for (int j = 0; j < kMotors; ++j)
      for (int i = 0; i < kJoints; ++i) ratio_[j][i] = sum[kMotors + kJoints * j + i];
    return true;
  }}

  const double *motor_position() const {{ return motor_position_; }}
  double ratio(int motor, int joint) const {{ return ratio_[motor][joint]; }}

  /// motor velocity = G joint velocity
  void joint_to_motor_velocity(const double joint[kJoints], double motor[kMotors]) const
  {{
    for (int j = 0; j < kMotors; ++j) {{
      motor[j] = 0.0;
      for (int i = 0; i < kJoints; ++i) motor[j] += ratio_[j][i] * joint[i];
    }}
  }}

  /// joint effort = G^T motor effort
  void motor_to_joint_effort(const double motor[kMotors], double joint[kJoints]) const
  {{
    for (int i = 0; i < kJoints; ++i) {{
      joint[i] = 0.0;
      for (int j = 0; j < kMotors; ++j) joint[i] += ratio_[j][i] * motor[j];
    }}
  }}
{square}
 private:
  double motor_position_[kMotors] = {{}};
  double ratio_[kMotors][kJoints] = {{}};
}};
"""
# With as many motors as joints the map can be inverted.
_SQUARE = """
  /// joint velocity = G^-1 motor velocity; false at a dead centre
  bool motor_to_joint_velocity(const double motor[kMotors], double joint[kJoints]) const
  {
    return solve(false, motor, joint);
  }

  /// motor effort = G^-T joint effort; false at a dead centre
  bool joint_to_motor_effort(const double joint[kJoints], double motor[kMotors]) const
  {
    return solve(true, joint, motor);
  }

  /// The joint position at a motor position, by Newton from the last one, which must be on the map. Returns false where it
  /// does not arrive. Afterwards the transmission is that of the joint position found.
  bool motor_to_joint_position(const double motor[kMotors], double joint[kJoints])
  {
    for (int step = 0; step < 30; ++step) {
      if (!at(joint)) return false;
      double off[kMotors], move[kJoints], largest = 0.0;
      for (int j = 0; j < kMotors; ++j) {
        off[j] = motor[j] - motor_position_[j];
        largest = std::fmax(largest, std::fabs(off[j]));
      }
      if (largest < 1e-9) return true;
      if (!solve(false, off, move)) return false;
      for (int i = 0; i < kJoints; ++i)
        joint[i] = std::fmin(std::fmax(joint[i] + move[i], kAxes[i][0]), kAxes[i][kNodes[i] - 1]);
    }
    return false;
  }

 private:
  /// Solve G x = b, or G^T x = b, by elimination with pivots.
  bool solve(bool transposed, const double b[kJoints], double x[kJoints]) const
  {
    double A[kJoints][kJoints + 1];
    for (int r = 0; r < kJoints; ++r) {
      for (int c = 0; c < kJoints; ++c) A[r][c] = transposed ? ratio_[c][r] : ratio_[r][c];
      A[r][kJoints] = b[r];
    }
    for (int k = 0; k < kJoints; ++k) {
      int pivot = k;
      for (int r = k + 1; r < kJoints; ++r) if (std::fabs(A[r][k]) > std::fabs(A[pivot][k])) pivot = r;
      if (!(std::fabs(A[pivot][k]) > 1e-12)) return false;
      for (int c = 0; c <= kJoints; ++c) std::swap(A[k][c], A[pivot][c]);
      for (int r = k + 1; r < kJoints; ++r) {
        const double factor = A[r][k] / A[k][k];
        for (int c = k; c <= kJoints; ++c) A[r][c] -= factor * A[k][c];
      }
    }
    for (int k = kJoints - 1; k >= 0; k--) {
      x[k] = A[k][kJoints];
      for (int c = k + 1; c < kJoints; ++c) x[k] -= A[k][c] * x[c];
      x[k] /= A[k][k];
    }
    return true;
  }
"""


def cpp_header(transfer: Transfer) -> str:
    """Return the header: the table of motor positions and G, and the class that interpolates and converts."""
    grid, outputs = transfer.table.grid, transfer.outputs
    joints = [
        f"//   joint {k}: {one.name} [{one.si_units[0]}], effort [{one.si_units[1]}]" for k, one in enumerate(outputs.joints)
    ]
    motors = [
        f"//   motor {k}: {one.name} [{one.si_units[0]}], effort [{one.si_units[1]}]"
        for k, one in enumerate(outputs.actuators)
    ]
    n, space = len(grid.points), identifier(" ".join(joint.name for joint in outputs.joints), "linkage")
    rows = np.hstack([grid.values[name].reshape(n, -1) for name in ("motor_position", "ratio")])
    nodes = [len(axis) for axis in grid.axes]
    data = [f"constexpr int kJoints = {len(nodes)};", f"constexpr int kMotors = {len(outputs.motors)};"]
    data += [
        "constexpr int kRow = kMotors * (1 + kJoints);",
        f"constexpr int kNodes[kJoints] = {{{', '.join(map(str, nodes))}}};",
    ]
    data += [f"constexpr double kAxis{k}[] = {{{_numbers(axis)}}};" for k, axis in enumerate(grid.axes)]
    data += [f"constexpr const double *kAxes[kJoints] = {{{', '.join(f'kAxis{k}' for k in range(len(nodes)))}}};"]
    data += ["// a row for each node, the last joint first to change: motor positions, then G by rows"]
    data += [f"constexpr double kTable[{n}][kRow] = {{"]
    data += [f"  {{{_numbers(row)}}}," for row in rows]
    data += ["};"]
    square = len(nodes) == len(outputs.motors)
    text = _CLASS.format(data="\n".join(data), square=_SQUARE if square else "")
    if square:
        text = text.replace("\n private:\n  double motor_position_", "\n  double motor_position_")
    error = f"{grid.errors['ratio']:.2g} of {grid.scale['ratio']:.4g}"
    about = [
        "// The transmission between motors and output joints of a linkage, as a table with linear interpolation.",
        "// motor velocity = G joint velocity, joint effort = G^T motor effort: motor power equals joint power with any"
        " table.",
        f"// Error of G between the nodes: {error}; of the motor positions: {grid.errors['motor_position']:.2g} of"
        f" {grid.scale['motor_position']:.4g}.",
        "// For a ros2_control plugin: joint_to_actuator and actuator_to_joint call these functions in every cycle.",
        *joints,
        *motors,
        "#pragma once",
        "",
        "#include <cmath>",
        "#include <limits>",
        "#include <utility>",
        "",
        f"namespace {space} {{",
    ]
    return "\n".join(about) + text + f"\n}}  // namespace {space}\n"


def _numbers(values: np.ndarray) -> str:
    return ", ".join(repr(float(x)) if np.isfinite(x) else "kNoNumber" for x in values)
