"""Proofs by `import linkplan`: of a new plan, of a saved one, and kept by a pickled one."""

import pickle

import linkplan


def test_a_plan_is_proved_when_asked_and_keeps_its_proof(tmp_path):
    plan = linkplan.plan("cart-pole-swing-up", prove=True)
    assert plan.proof.complete
    assert plan.proof.verdict == "proved"
    assert plan.to_dict()["proof"]["proved"]
    assert pickle.loads(pickle.dumps(plan)).proof == plan.proof
    assert "proof: proved" in str(plan)
    again = linkplan.read_plan(plan.save(tmp_path / "swing-up"))
    assert again.proof is None
    assert again.prove().complete


def test_a_plan_comes_with_a_proof_if_there_is_time_for_one(monkeypatch):
    proof = linkplan.plan("cart-pole-swing-up").proof
    assert proof is not None
    assert proof.passed
    monkeypatch.setattr("linkplan.plans._PROOF_SECONDS", 0.0)
    monkeypatch.setattr("linkplan.plans._PROOF_SHARE", 0.0)
    said: list[str] = []
    assert linkplan.plan("cart-pole-swing-up", said.append).proof is None
    assert any(line.startswith("proof skipped") for line in said)
