"""Check if the nodes on the bus are those of the config: read by SDO, never written to, and judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hilbench.apps.doctor.findings import Check, Finding, error, ok, warning
from hilbench.apps.doctor.subject import ExpectedNode, MappedObject
from hilbench.canopen.listening import Received, master_at_work
from hilbench.canopen.sdo_client import Answer, Refusal, SdoClient

_DEVICE_TYPE = (0x1000, 0)
_IDENTITY = ((0x1018, 1), (0x1018, 2), (0x1018, 3))  # vendor id, product code, revision number
_PROFILE_MASK = 0xFFFF  # 1000h: device profile number in the low half
_WRITE_ONLY = 0x06010001


#: Answers of one node, by object; none where it gave none to a read of its device type.
NodeAnswers = Mapping[tuple[int, int], Answer]


def ask(reader: SdoClient, node: ExpectedNode) -> NodeAnswers:
    """Read device type, identity and the mapped objects of one node."""
    device_type = reader.read(node.node_id, 0x1000)
    if device_type is None:
        return {}
    keys = (*_IDENTITY, *((item.index, item.sub) for item in node.mapped))
    return {_DEVICE_TYPE: device_type, **{key: reader.read(node.node_id, *key) for key in keys}}


def check_received(
    received: Received, expected: Sequence[ExpectedNode], master_id: int, bus: str, claimed_by: str | None = None
) -> list[Finding]:
    """Findings on unsolicited frames; `claimed_by`: the program that has claimed to be the master."""
    master = master_at_work(received, claimed_by, master_id)
    findings = [
        ok(Check.OTHER_MASTER, bus, "none received") if master is None else error(Check.OTHER_MASTER, bus, master)
    ]
    known = {node.node_id for node in expected} | {master_id}
    strangers = {node_id: ids for node_id, ids in received.nodes.items() if node_id not in known}
    if strangers:
        found = "; ".join(
            f"node {node_id} ({' '.join(f'{cob_id:03X}h' for cob_id in sorted(ids))})"
            for node_id, ids in strangers.items()
        )
        findings.append(warning(Check.STRANGERS, bus, found))
    else:
        findings.append(ok(Check.STRANGERS, bus, "no node that is not in the config was received"))
    return findings


def check_node(node: ExpectedNode, answers: NodeAnswers) -> list[Finding]:
    """Findings on one node that was read."""
    if not answers:
        command = "twin" if node.part.startswith("virtual") else "simulate-hardware"
        problem = "node_not_started" if node.ours else ""
        found = "no answer to an SDO read of 1000h"
        return [error(Check.NODE_ANSWERS, node.subject, found, problem, command=command, node_id=node.node_id)]
    return [
        ok(Check.NODE_ANSWERS, node.subject, f"answers; 1000h is {_hex(answers[_DEVICE_TYPE])}"),
        _identity(node, answers),
        *_mapped(node, answers),
    ]


def _identity(node: ExpectedNode, answers: NodeAnswers) -> Finding:
    """1000h and 1018h against the EDS. Another revision may do; another maker, product or profile may not."""
    checks = [
        ("vendor id", answers[_IDENTITY[0]], node.identity[0], error),
        ("product code", answers[_IDENTITY[1]], node.identity[1], error),
        ("revision", answers[_IDENTITY[2]], node.identity[2], warning),
    ]
    device_type = answers[_DEVICE_TYPE]
    if node.device_type and isinstance(device_type, bytes):
        found = int.from_bytes(device_type, "little") & _PROFILE_MASK
        wanted = node.device_type & _PROFILE_MASK
        if found != wanted:
            values = {"wanted": wanted, "eds": node.eds.name, "node_id": node.node_id}
            return error(Check.IDENTITY, node.subject, f"device profile {found}", "device_profile", **values)
    for name, answer, allowed, finding in checks:
        if allowed and not (isinstance(answer, bytes) and int.from_bytes(answer, "little") in allowed):
            wanted_text = " or ".join(f"{value:08X}h" for value in sorted(allowed))
            found_text = f"{name} {_hex(answer)}"
            return finding(Check.IDENTITY, node.subject, found_text, wanted=wanted_text, eds=node.eds.name)
    compared = [name for name, _, wanted, _ in checks if wanted]
    text = " ".join(_hex(answers[key]) for key in _IDENTITY)
    return ok(Check.IDENTITY, node.subject, f"1018h is {text}; {', '.join(compared) or 'nothing'} given by the EDS")


def _mapped(node: ExpectedNode, answers: NodeAnswers) -> list[Finding]:
    problems = [finding for item in node.mapped if (finding := _object(node, item, answers))]
    if problems:
        return problems
    names = " ".join(_object_name(item) for item in node.mapped)
    return [ok(Check.MAPPED_OBJECTS, node.subject, f"{names or 'none'}: there, as long as the EDS says")]


def _object(node: ExpectedNode, item: MappedObject, answers: NodeAnswers) -> Finding | None:
    answer = answers[item.index, item.sub]
    if isinstance(answer, Refusal) and answer.code == _WRITE_ONLY:
        return None  # it is there, and its length cannot be seen
    if isinstance(answer, bytes) and 8 * len(answer) == item.bits:
        return None
    found = f"{8 * len(answer)} bits" if isinstance(answer, bytes) else str(answer or "no answer")
    text = f"{_object_name(item)} '{item.name}': {found}"
    return error(Check.MAPPED_OBJECTS, node.subject, text, bits=item.bits, eds=node.eds.name)


def _object_name(item: MappedObject) -> str:
    return f"{item.index:04X}h" + (f" sub {item.sub}" if item.sub else "")


def _hex(answer: Answer) -> str:
    if isinstance(answer, bytes):
        return f"{int.from_bytes(answer, 'little'):08X}h"
    return "no answer" if answer is None else str(answer)
