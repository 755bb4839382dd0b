"""Parts of the body by the names of usual skeletons."""

import numpy as np
import pytest

from assets.body_parts import PARTS, common_ancestor, find_parts
from tests.refusals import refuses

# Names of the left limbs, upper arm to hand and upper leg to toes, in skeletons that artists meet.
SKELETONS = {
    "mixamo": "mixamorig:LeftArm mixamorig:LeftForeArm mixamorig:LeftHand "
    "mixamorig:LeftUpLeg mixamorig:LeftLeg mixamorig:LeftFoot mixamorig:LeftToeBase",
    "unreal": "upperarm_l lowerarm_l hand_l thigh_l calf_l foot_l ball_l",
    "rigify": "DEF-upper_arm.L DEF-forearm.L DEF-hand.L DEF-thigh.L DEF-shin.L DEF-foot.L DEF-toe.L",
    "vrm": "J_Bip_L_UpperArm J_Bip_L_LowerArm J_Bip_L_Hand J_Bip_L_UpperLeg J_Bip_L_LowerLeg J_Bip_L_Foot",
    "biped": "Bip01_L_UpperArm Bip01_L_Forearm Bip01_L_Hand Bip01_L_Thigh Bip01_L_Calf Bip01_L_Foot Bip01_L_Toe0",
    "max": "LeftShoulder LeftElbow LeftWrist LeftHip LeftKnee LeftAnkle LeftToe",
    "smpl": "L_Shoulder L_Elbow L_Wrist L_Hip L_Knee L_Ankle",
    "bandai": "UpperArm_L LowerArm_L Hand_L UpperLeg_L LowerLeg_L Foot_L Toes_L",
}
LEFT = [part for part in PARTS if part.startswith("left")]


@pytest.mark.parametrize("kind", SKELETONS)
def test_limbs_of_usual_skeletons(kind: str) -> None:
    names = SKELETONS[kind].split()
    found = find_parts(names)
    assert [found[part] for part in LEFT[: len(names)]] == list(range(len(names)))


def test_joints_beside_a_limb_are_not_taken_for_it() -> None:
    names = (
        "Hips LHipJoint LeftUpLeg LeftLeg LeftFoot LeftShoulder LeftArm LeftArmRoll LeftForeArm LeftHand lhand".split()
    )
    found = find_parts([*names, "LeftHandFinger1", "RightShoulder"])
    chosen = {part: [*names, "", "RightShoulder"][joint] for part, joint in found.items()}
    assert chosen == {
        "left upper arm": "LeftArm",
        "left lower arm": "LeftForeArm",
        "left hand": "LeftHand",
        "left upper leg": "LeftUpLeg",
        "left lower leg": "LeftLeg",
        "left foot": "LeftFoot",
    }


def test_the_first_of_equal_names_counts() -> None:
    assert find_parts(["thigh.L", "thigh.L.001"]) == {"left upper leg": 0}


def test_a_common_ancestor() -> None:
    parents = np.array([-1, 0, 1, 2, 1, -1], np.int32)
    assert common_ancestor(parents, [3, 4]) == 1
    assert common_ancestor(parents, [3, 2]) == 2
    refuses("different roots", common_ancestor, parents, [3, 5])
