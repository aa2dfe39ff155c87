// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {Fixture} from "./Fixture.sol";

/// @notice What members, strangers and holders of single roles may not do: everybody at every door, crowds, and calls
/// that no interface knows.
contract AttacksTest is Fixture {
    address private constant STRANGER = address(0x51);
    address private constant ADMIN = address(0x52);
    address private constant COORDINATOR = address(0x53);
    address private constant PUBLISHER = address(0x54);
    address private constant AUTHORITY = address(0x55);

    function setUp() public {
        deploy();
        relay.grantRole(relay.COORDINATOR_ROLE(), COORDINATOR);
        relay.grantRole(relay.PUBLISHER_ROLE(), PUBLISHER);
        relay.grantRole(relay.REPUTATION_ROLE(), AUTHORITY);
        // This contract has served: whoever acts below has one role, or none.
        relay.renounceRole(relay.COORDINATOR_ROLE(), address(this));
        relay.renounceRole(relay.PUBLISHER_ROLE(), address(this));
        relay.renounceRole(relay.REPUTATION_ROLE(), address(this));
        relay.renounceRole(relay.REGISTRAR_ROLE(), address(this));
        relay.beginDefaultAdminTransfer(ADMIN);
        vm.warp(block.timestamp + 1 days + 1);
        vm.prank(ADMIN);
        relay.acceptDefaultAdminTransfer();
    }

    function card() private pure returns (ModelCard memory) {
        return ModelCard(1, 5, 1, 20, 11, 6, 9, -3_000);
    }

    function cid(uint256 i) private pure returns (bytes memory) {
        return abi.encodePacked(hex"01551220", bytes32(i));
    }

    // Roles: who gets through which door

    function parties() private pure returns (address[7] memory) {
        return [STRANGER, uav(0), vehicle(0), ADMIN, COORDINATOR, PUBLISHER, AUTHORITY];
    }

    /// @dev Calls behind which stands a role (a publisher may retire its own), and who may pass.
    function doors(bytes32 model) private view returns (bytes[9] memory calls, uint8[9] memory open) {
        calls[0] = abi.encodeCall(relay.allocateZone, (1, 10));
        calls[1] = abi.encodeCall(relay.resetListsForZone, (1));
        calls[2] = abi.encodeCall(relay.setZoneCoordinator, (7, address(0x99)));
        calls[3] = abi.encodeCall(relay.determineMDRLModel, (2));
        calls[4] = abi.encodeCall(relay.registerModel, (cid(7), card()));
        calls[5] = abi.encodeCall(relay.setReputations, (new address[](0), new uint16[](0)));
        calls[6] = abi.encodeCall(relay.grantRole, (relay.COORDINATOR_ROLE(), address(0x99)));
        calls[7] = abi.encodeCall(relay.revokeRole, (relay.COORDINATOR_ROLE(), address(0x99)));
        calls[8] = abi.encodeCall(relay.retireModel, (model));
        // A bit for each party, in their order.
        open = [16, 16, 8, 16, 32, 64, 8, 8, 8 + 32];
    }

    function test_everyDoorIsOpenToItsRoleAloneAndToldSo() public {
        addUAV(0, 5_000, 1);
        addVehicle(0, 1, 1);
        addUAV(1, 5_000, 2);
        addVehicle(1, 1, 2);
        submit(vehicle(1), uav(1), 1_000, 1);
        vm.prank(COORDINATOR);
        check(relay.allocateZone(2, 10), "zone 2 has a selection");
        vm.prank(PUBLISHER);
        bytes32 model = relay.registerModel(cid(1), card());
        (bytes[9] memory calls, uint8[9] memory open) = doors(model);
        address[7] memory callers = parties();
        for (uint256 door = 0; door < 9; ++door) {
            for (uint256 party = 0; party < 7; ++party) {
                bool allowed = open[door] >> party & 1 == 1;
                bytes memory asked = calls[door];
                // What can be done once only, done on something new.
                if (allowed && door == 4) asked = abi.encodeCall(relay.registerModel, (cid(100 + party), card()));
                if (allowed && door == 8) {
                    vm.prank(PUBLISHER);
                    asked = abi.encodeCall(relay.retireModel, (relay.registerModel(cid(200 + party), card())));
                }
                vm.prank(callers[party]);
                (bool success, bytes memory answer) = address(relay).call(asked);
                check(success == allowed, allowed ? "the role's holder is kept out" : "a door stands open");
                if (!allowed) {
                    check(bytes4(answer) == IAccessControl.AccessControlUnauthorizedAccount.selector, "another reason");
                }
            }
        }
    }

    function test_aRoleThatIsTakenAwayIsGone() public {
        addUAV(0, 5_000, 1);
        bytes32 role = relay.COORDINATOR_ROLE();
        vm.prank(ADMIN);
        relay.revokeRole(role, COORDINATOR);
        vm.prank(COORDINATOR);
        vm.expectRevert(
            abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, COORDINATOR, role)
        );
        relay.allocateZone(1, 10);
    }

    function test_aPublisherDoesNotRetireAnothersModel() public {
        vm.prank(PUBLISHER);
        bytes32 model = relay.registerModel(cid(1), card());
        bytes32 role = relay.PUBLISHER_ROLE();
        vm.prank(ADMIN);
        relay.grantRole(role, STRANGER);
        vm.prank(STRANGER);
        vm.expectRevert(
            abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, STRANGER, bytes32(0))
        );
        relay.retireModel(model);
    }

    function test_aUAVIsNoVehicleAndAVehicleNoUAV() public {
        addUAV(0, 5_000, 1);
        addVehicle(0, 1, 1);
        vm.prank(uav(0));
        vm.expectRevert(abi.encodeWithSelector(UnknownVehicle.selector, uav(0)));
        relay.updateVehicleInfo(0, 0, 1, 1);
        vm.prank(uav(0));
        vm.expectRevert(abi.encodeWithSelector(UnknownVehicle.selector, uav(0)));
        relay.submitVehSelection(uav(0), 1_000, 1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(UnknownUAV.selector, vehicle(0)));
        relay.updateUAVInfo(0, 0, 0, 1, 1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(UnknownUAV.selector, vehicle(0)));
        relay.submitVehSelection(vehicle(0), 1_000, 1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(UnknownUAV.selector, vehicle(0)));
        relay.resetUAVSubmission(vehicle(0));
    }

    // Calls that no interface knows

    function testFuzz_whatNeitherPartKnowsReverts(uint256 seed, bytes calldata rest) public {
        bytes4 unknown = bytes4(keccak256(abi.encode("no such function", seed)));
        (bool success,) = address(relay).call(abi.encodePacked(unknown, rest));
        check(!success, "an unknown function was answered");
    }

    function test_moneyIsNotTaken() public {
        vm.deal(address(this), 3);
        (bool success,) = address(relay).call{value: 1}("");
        check(!success, "plain");
        (success,) = address(relay).call{value: 1}(abi.encodeCall(relay.registerVehicle, (0, 0, 1, 1)));
        check(!success, "with a call");
        (success,) = address(relay).call{value: 1}(abi.encodeCall(relay.uavCount, ()));
        check(!success, "with a call of the extension's");
    }

    // Crowds: what others pay

    function gasOf(address caller, bytes memory data) private returns (uint256 spent) {
        vm.prank(caller);
        uint256 before = gasleft();
        (bool success,) = address(relay).call(data);
        spent = before - gasleft();
        check(success, "the call goes through");
    }

    function test_aResetCostsTheSameWhateverACrowdHasPutIntoTheZone() public {
        addUAV(0, 5_000, 1);
        addVehicle(0, 1, 1);
        submit(vehicle(0), uav(0), 1_000, 1);
        bytes memory reset = abi.encodeCall(relay.resetListsForZone, (1));
        vm.prank(COORDINATOR);
        relay.allocateZone(1, 1_000);
        uint256 alone = gasOf(COORDINATOR, reset);
        for (uint256 i = 1; i < 200; ++i) {
            addUAV(i, 5_000, 1);
            addVehicle(i, 1, 1);
            submit(vehicle(i), uav(i % 3), 1_000, 3);
        }
        vm.prank(COORDINATOR);
        relay.allocateZone(1, 1_000);
        check(gasOf(COORDINATOR, reset) <= alone, "a crowd makes it dearer");
    }

    function test_aPieceOfAnAllocationCostsWhatWasAskedForWhateverACrowdHasPutIntoTheZone() public {
        // 300 UAVs that nobody proposes to, then 20 with 20 proposals each.
        for (uint256 i = 0; i < 320; ++i) {
            addUAV(i, 20_000, 1);
        }
        for (uint256 i = 0; i < 400; ++i) {
            addVehicle(i, uint32(i), 1);
            submit(vehicle(i), uav(300 + i % 20), uint32(1 + i), 1);
        }
        uint256 pieces = 0;
        uint256 dearest = 0;
        while (round(1) == 1) {
            uint256 spent = gasOf(COORDINATOR, abi.encodeCall(relay.allocateZone, (1, 40)));
            if (spent > dearest) dearest = spent;
            ++pieces;
        }
        // 300 UAVs at one each, 400 proposals, in pieces of 40.
        check(pieces >= 17 && pieces <= 19, "pieces");
        check(dearest < 700_000, "a piece is dearer than 40 proposals");
        equal(relay.getZoneInfo(1).selectedVehicles, 400, "all decided, and all fit");
    }

    function test_aFullRegistryOfModelsIsSearchedWithinABlock() public {
        addUAV(0, 5_000, 1);
        addVehicle(0, 1, 1);
        submit(vehicle(0), uav(0), 1_000, 1);
        vm.prank(COORDINATOR);
        relay.allocateZone(1, 10);
        for (uint256 i = 0; i < 64; ++i) {
            vm.prank(PUBLISHER);
            relay.registerModel(cid(i), card());
        }
        check(gasOf(COORDINATOR, abi.encodeCall(relay.determineMDRLModel, (1))) < 600_000, "gas of the search");
    }

    // What is told is what counts

    function testFuzz_qualityIsWhatAProposalGets(int16 x, int16 y, uint16 payment, uint16 demand) public {
        addUAV(0, 5_000, 1);
        vm.prank(vehicle(0));
        relay.registerVehicle(int32(x) / 2, int32(y) / 2, uint32(payment) % 701, 1);
        uint32 asked = 1 + uint32(demand) % 4_000;
        (uint64 qov, uint64 score) = relay.quality(vehicle(0), uav(0), asked);
        check(qov <= 1e17, "QoV is at most 100");
        submit(vehicle(0), uav(0), asked, 1);
        equal(relay.getProposals(uav(0))[0].score, score, "score");
        equal(relay.uavCount(), 1, "count");
        check(relay.uavAt(0) == uav(0), "list");
    }
}
