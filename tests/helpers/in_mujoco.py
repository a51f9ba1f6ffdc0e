"""A model in MuJoCo: joints put where they are told, loops closed by MuJoCo's own constraints."""

import mujoco
import numpy as np


class Bodies:
    """A model of ``ppmcal export mjcf``, with its drives held."""

    def __init__(self, text):
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        m = self.model
        self.joint = [i for i in range(m.nu) if m.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT]
        self.rope = [i for i in range(m.nu) if i not in self.joint]
        held = {m.jnt_dofadr[m.actuator_trnid[i, 0]] for i in self.joint}
        self.free = [v for v in range(m.nv) if v not in held]

    def names(self):
        """Return the actuators' names."""
        return [self.model.actuator(i).name for i in range(self.model.nu)]

    def go(self, q, parts=4, steps=30):
        """Put the drives at joint values q by actuator, in parts of the way, and close loops."""
        m, d = self.model, self.data
        start = self.data.ctrl.copy()
        for part in np.linspace(0.0, 1.0, parts + 1)[1:]:
            d.ctrl[:] = start + part * (q - start)
            for i in self.joint:
                d.qpos[m.jnt_qposadr[m.actuator_trnid[i, 0]]] = d.ctrl[i] / m.actuator_gear[i, 0]
            for _ in range(steps):
                gap, rate = self.gaps()
                if np.abs(gap).max() < 1e-13:
                    break
                step = np.zeros(m.nv)
                step[self.free] = -np.linalg.pinv(rate[:, self.free], 1e-10) @ gap
                mujoco.mj_integratePos(m, d.qpos, step, 1.0)
        return np.abs(self.gaps()[0]).max()

    def gaps(self):
        """Return how far loops and ropes are from closing, and the Jacobian of that."""
        m, d = self.model, self.data
        mujoco.mj_fwdPosition(m, d)
        own = d.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        rates = d.efc_J.reshape(-1, m.nv)[own] if len(d.efc_J) == d.nefc * m.nv else None
        if rates is None:
            rates = np.zeros((d.nefc, m.nv))
            mujoco.mju_sparse2dense(rates, d.efc_J, d.efc_J_rownnz, d.efc_J_rowadr, d.efc_J_colind)
            rates = rates[own]
        gaps = [d.efc_pos[own]]
        tendons = np.zeros((m.ntendon, m.nv))
        if m.ntendon and d.ten_J.size == m.ntendon * m.nv:
            tendons = d.ten_J.reshape(m.ntendon, m.nv)
        elif m.ntendon:
            mujoco.mju_sparse2dense(tendons, d.ten_J, m.ten_J_rownnz, m.ten_J_rowadr,
                                    m.ten_J_colind)
        for i in self.rope:
            rope = m.actuator_trnid[i, 0]
            added = m.actuator_biasprm[i, 0] / m.actuator_gainprm[i, 0]
            gaps.append([d.ten_length[rope] - (d.ctrl[i] + added) / m.actuator_gear[i, 0]])
            rates = np.vstack([rates, tendons[rope]])
        return np.concatenate(gaps), rates

    def settled(self, q, seconds=1.0):
        """Return the platform after its actuators went to q, without weight."""
        m, d = self.model, self.data
        m.opt.gravity[:] = 0.0
        start = d.ctrl.copy()
        for part in np.linspace(0.0, 1.0, 100)[1:]:
            d.ctrl[:] = start + part**2 * (3.0 - 2.0 * part) * (q - start)
            mujoco.mj_step(m, d, nstep=10)
        mujoco.mj_step(m, d, nstep=int(seconds / m.opt.timestep))
        mujoco.mj_kinematics(m, d)
        return self.pose()

    def pose(self):
        """Return the site ``platform``: position (3,), m, and rotation (3, 3)."""
        at = self.data.site("platform")
        return at.xpos.copy(), at.xmat.reshape(3, 3).copy()
