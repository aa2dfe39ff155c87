// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {ISkyRelayExtension} from "../src/interfaces/ISkyRelayExtension.sol";
import {Fixture} from "./Fixture.sol";

/// @notice What each function does and what it refuses, one behaviour a test.
contract SkyRelayTest is Fixture {
    bytes private constant CID = hex"0155122000112233445566778899aabbccddeeff00112233445566778899aabbccddeeff";

    function setUp() public {
        deploy();
    }

    function card(uint16 minUAVs, uint16 maxUAVs, int32 score) private pure returns (ModelCard memory) {
        return ModelCard({
            minUAVs: minUAVs,
            maxUAVs: maxUAVs,
            minVehicles: 1,
            maxVehicles: 20,
            observationSide: 11,
            channels: 6,
            actions: 9,
            score: score
        });
    }

    function cidOf(uint8 last) private pure returns (bytes memory cid) {
        cid = CID;
        cid[35] = bytes1(last);
    }

    // Deployment

    function test_deploymentRefusesWeightsThatDoNotSumToOne() public {
        address extension = newExtension(parameters());
        Parameters memory p = parameters();
        p.qovWeights[0] += 1;
        vm.expectRevert(InvalidParameters.selector);
        newRelay(p, extension);
        p = parameters();
        p.qouWeights[3] -= 1;
        vm.expectRevert(InvalidParameters.selector);
        newRelay(p, extension);
    }

    function test_deploymentRefusesAMaximumOfZeroAndAnExtensionWithoutCode() public {
        address extension = newExtension(parameters());
        for (uint256 i = 0; i < 8; ++i) {
            Parameters memory p = parameters();
            if (i == 0) p.maxBandwidth = 0;
            if (i == 1) p.maxDemand = 0;
            if (i == 2) p.maxPayment = 0;
            if (i == 3) p.maxDistance = 0;
            if (i == 4) p.initialReputation = 10_001;
            if (i == 5) p.ratingStep = 10_001;
            if (i == 6) p.channels = 0;
            if (i == 7) p.actions = 0;
            vm.expectRevert(InvalidParameters.selector);
            newRelay(p, extension);
        }
        vm.expectRevert(InvalidParameters.selector);
        newRelay(parameters(), address(0x1234));
    }

    function test_extensionAloneServesNobody() public {
        ISkyRelayExtension alone = ISkyRelayExtension(newExtension(parameters()));
        vm.expectRevert();
        alone.registerModel(CID, card(1, 3, 0));
        vm.expectRevert();
        alone.setReputations(new address[](0), new uint16[](0));
        vm.expectRevert(abi.encodeWithSelector(UnknownVehicle.selector, address(this)));
        alone.rateUAV(address(1), true);
    }

    // Roles and records

    function test_onlyRolesAllocateResetPublishAndSetReputations() public {
        addUAV(0, 5_000, 1);
        address stranger = vehicle(9);
        bytes32 coordinator = relay.COORDINATOR_ROLE();
        bytes memory refusal =
            abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, stranger, coordinator);
        vm.prank(stranger);
        vm.expectRevert(refusal);
        relay.allocateZone(1, 10);
        vm.prank(stranger);
        vm.expectRevert(refusal);
        relay.resetListsForZone(1);
        vm.prank(stranger);
        vm.expectRevert(refusal);
        relay.determineMDRLModel(1);
        vm.prank(stranger);
        vm.expectRevert(abi.encodeWithSelector(NotOwnRecord.selector, uav(0), stranger));
        relay.resetUAVSubmission(uav(0));
        bytes32 publisher = relay.PUBLISHER_ROLE();
        vm.prank(stranger);
        vm.expectRevert(
            abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, stranger, publisher)
        );
        relay.registerModel(CID, card(1, 3, 0));
        bytes32 reputation = relay.REPUTATION_ROLE();
        vm.prank(stranger);
        vm.expectRevert(
            abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, stranger, reputation)
        );
        relay.setReputations(new address[](0), new uint16[](0));
    }

    function test_nobodyMovesAnothersUAV() public {
        addUAV(0, 5_000, 1);
        vm.prank(uav(1));
        vm.expectRevert(abi.encodeWithSelector(NotOwnRecord.selector, uav(0), uav(1)));
        relay.updateUAVZone(uav(0), 2);
    }

    function test_unknownMembersZonesAndModelsRevert() public {
        vm.expectRevert(abi.encodeWithSelector(UnknownUAV.selector, uav(0)));
        relay.getUAVInfo(uav(0));
        vm.expectRevert(abi.encodeWithSelector(UnknownVehicle.selector, vehicle(0)));
        relay.getVehicleInfo(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(UnknownZone.selector, uint32(7)));
        zoneUAVs(7);
        vm.expectRevert(abi.encodeWithSelector(UnknownZone.selector, uint32(7)));
        relay.allocateZone(7, 1);
        vm.expectRevert(abi.encodeWithSelector(UnknownZone.selector, uint32(7)));
        relay.resetListsForZone(7);
        vm.expectRevert(abi.encodeWithSelector(UnknownModel.selector, bytes32(0)));
        relay.getModel(0);
        vm.expectRevert(abi.encodeWithSelector(UnknownVehicle.selector, address(this)));
        relay.updateVehicleInfo(0, 0, 0, 1);
        vm.expectRevert(abi.encodeWithSelector(UnknownUAV.selector, address(this)));
        relay.updateUAVInfo(0, 0, 0, 1, 1);
        address[] memory members = new address[](1);
        vm.expectRevert(abi.encodeWithSelector(UnknownMember.selector, address(0)));
        relay.setReputations(members, new uint16[](1));
    }

    function test_aMemberRegistersOnceAndAsOneKind() public {
        addUAV(0, 5_000, 1);
        vm.prank(uav(0));
        vm.expectRevert(abi.encodeWithSelector(AlreadyRegistered.selector, uav(0)));
        relay.registerUAV(0, 0, 0, 0, 0, 0);
        vm.prank(uav(0));
        vm.expectRevert(abi.encodeWithSelector(AlreadyRegistered.selector, uav(0)));
        relay.registerVehicle(0, 0, 0, 0);
    }

    function test_valuesAboveTheirMaximumRevert() public {
        vm.expectRevert(abi.encodeWithSelector(OutOfRange.selector, 10_001, 10_000));
        relay.registerUAV(0, 0, 0, 10_001, 1, 0);
        vm.expectRevert(abi.encodeWithSelector(OutOfRange.selector, 20_001, 20_000));
        relay.registerUAV(0, 0, 0, 1, 20_001, 0);
        vm.expectRevert(abi.encodeWithSelector(OutOfRange.selector, 701, 700));
        relay.registerVehicle(0, 0, 701, 0);
        addUAV(0, 5_000, 1);
        addVehicle(0, 1, 1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(OutOfRange.selector, 4_001, 4_000));
        relay.submitVehSelection(uav(0), 4_001, 1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(OutOfRange.selector, 0, 4_000));
        relay.submitVehSelection(uav(0), 0, 1);
    }

    function testFuzz_recordsReadBackAsWritten(
        int32 x,
        int32 y,
        uint16 altitude,
        uint16 battery,
        uint32 bandwidth,
        uint32 payment,
        uint32 zone,
        uint32 time
    ) public {
        time = uint32(bound(time, 1, type(uint32).max - 1));
        vm.warp(time);
        battery = uint16(bound(battery, 0, 10_000));
        bandwidth = uint32(bound(bandwidth, 0, 20_000));
        payment = uint32(bound(payment, 0, 700));
        vm.prank(uav(0));
        relay.registerUAV(x, y, altitude, battery, bandwidth, zone);
        UAVInfo memory u = relay.getUAVInfo(uav(0));
        check(u.x == x && u.y == y && u.altitude == altitude && u.battery == battery, "uav");
        check(u.bandwidth == bandwidth && u.available == bandwidth && u.zone == zone, "uav");
        check(u.reputation == 5_000 && u.timestamp == time && u.index == 0, "uav");
        vm.prank(vehicle(0));
        relay.registerVehicle(x, y, payment, zone);
        VehicleInfo memory v = relay.getVehicleInfo(vehicle(0));
        check(v.x == x && v.y == y && v.payment == payment && v.zone == zone, "vehicle");
        check(v.reputation == 5_000 && v.timestamp == time, "vehicle");
        vm.prank(vehicle(0));
        relay.updateVehicleInfo(y, x, 3, 9);
        v = relay.getVehicleInfo(vehicle(0));
        check(v.x == y && v.y == x && v.payment == 3 && v.zone == 9 && v.reputation == 5_000, "vehicle update");
        vm.prank(uav(0));
        relay.updateUAVInfo(y, x, 5, 6, 7);
        u = relay.getUAVInfo(uav(0));
        check(u.x == y && u.y == x && u.altitude == 5 && u.battery == 6 && u.bandwidth == 7, "uav update");
        check(u.zone == zone && u.reputation == 5_000, "uav update");
    }

    // Proposals

    function test_aVehicleWithoutAnyUAVMayMove() public {
        addVehicle(0, 1, 0);
        check(status(vehicle(0)) == ProposalStatus.None, "no proposal");
        vm.prank(vehicle(0));
        relay.updateVehicleInfo(1, 1, 1, 3);
        equal(relay.getVehicleInfo(vehicle(0)).zone, 3, "zone");
    }

    function test_proposalsOnlyWithinZoneRangeRoundAndCharge() public {
        addUAV(0, 5_000, 1);
        addUAV(1, 5_000, 0);
        addVehicle(0, 1, 2);
        addVehicle(1, 1, 1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(DifferentZone.selector, uint32(2), uint32(1)));
        relay.submitVehSelection(uav(0), 1_000, 1);
        vm.prank(vehicle(1));
        vm.expectRevert(abi.encodeWithSelector(DifferentZone.selector, uint32(1), uint32(0)));
        relay.submitVehSelection(uav(1), 1_000, 1);
        vm.prank(vehicle(1));
        vm.expectRevert(abi.encodeWithSelector(WrongRound.selector, uint32(2), uint32(1)));
        relay.submitVehSelection(uav(0), 1_000, 2);
        vm.prank(vehicle(1));
        relay.updateVehicleInfo(30_001, 0, 1, 1);
        vm.prank(vehicle(1));
        vm.expectRevert(abi.encodeWithSelector(TooFar.selector, uint256(30_001e15), uint256(30_000e15)));
        relay.submitVehSelection(uav(0), 1_000, 1);
        vm.prank(vehicle(1));
        relay.updateVehicleInfo(30_000, 0, 1, 1);
        vm.prank(uav(0));
        relay.updateUAVInfo(0, 0, 0, 0, 5_000);
        vm.prank(vehicle(1));
        vm.expectRevert(abi.encodeWithSelector(UAVEmpty.selector, uav(0)));
        relay.submitVehSelection(uav(0), 1_000, 1);
        vm.prank(uav(0));
        relay.updateUAVInfo(0, 0, 0, 1, 5_000);
        submit(vehicle(1), uav(0), 1_000, 1);
    }

    function test_oneOpenProposalARoundAndNoReplay() public {
        addUAV(0, 2_000, 1);
        addUAV(1, 2_000, 1);
        addVehicle(0, 1, 1);
        submit(vehicle(0), uav(0), 1_000, 1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(ProposalOpen.selector, vehicle(0)));
        relay.submitVehSelection(uav(1), 1_000, 1);
        allocate(1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(AlreadySelected.selector, vehicle(0)));
        relay.submitVehSelection(uav(1), 1_000, 2);
        relay.resetListsForZone(1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(WrongRound.selector, uint32(1), uint32(3)));
        relay.submitVehSelection(uav(0), 1_000, 1);
        submit(vehicle(0), uav(1), 1_000, 3);
    }

    function test_aRejectedVehicleTriesElsewhereAndMayDisplace() public {
        addUAV(0, 1_000, 1);
        addUAV(1, 1_000, 1);
        address poor = addVehicle(0, 0, 1);
        address rich = addVehicle(1, 700, 1);
        address middle = addVehicle(2, 300, 1);
        submit(poor, uav(1), 1_000, 1);
        submit(middle, uav(0), 1_000, 1);
        submit(rich, uav(0), 1_000, 1);
        allocate(1);
        check(status(poor) == ProposalStatus.Selected && status(rich) == ProposalStatus.Selected, "first round");
        check(status(middle) == ProposalStatus.Rejected, "first round");
        vm.prank(middle);
        vm.expectRevert(abi.encodeWithSelector(AlreadyRejected.selector, middle, uav(0)));
        relay.submitVehSelection(uav(0), 1_000, 2);
        submit(middle, uav(1), 1_000, 2);
        allocate(1);
        check(status(middle) == ProposalStatus.Selected && status(poor) == ProposalStatus.Rejected, "displaced");
        equal(relay.getZoneInfo(1).selectedVehicles, 2, "selected vehicles");
        equal(relay.getZoneInfo(1).selectedUAVs, 2, "selected UAVs");
    }

    function test_equalScoresGoToTheEarlierAndSmallerOnesMayStillFit() public {
        addUAV(0, 2_500, 1);
        for (uint256 i = 0; i < 3; ++i) {
            vm.prank(vehicle(i));
            relay.registerVehicle(0, 0, 100, 1);
        }
        vm.prank(vehicle(3));
        relay.registerVehicle(0, 0, 0, 1);
        for (uint256 i = 0; i < 3; ++i) {
            submit(vehicle(2 - i), uav(0), 1_000, 1);
        }
        submit(vehicle(3), uav(0), 500, 1);
        allocate(1);
        VehicleSelection[] memory proposals = relay.getProposals(uav(0));
        equal(proposals[0].score, proposals[2].score, "equal scores");
        check(proposals[0].status == ProposalStatus.Selected, "earliest");
        check(proposals[1].status == ProposalStatus.Selected, "second");
        check(proposals[2].status == ProposalStatus.Rejected, "does not fit");
        check(proposals[3].status == ProposalStatus.Selected, "smaller one fits");
        equal(relay.getUAVInfo(uav(0)).available, 0, "available");
    }

    function test_proposalListIsBoundedAndAFullOneIsAllocated() public {
        addUAV(0, 20_000, 1);
        for (uint256 i = 0; i < 1_024; ++i) {
            addVehicle(i, uint32(i % 701), 1);
            submit(vehicle(i), uav(0), uint32(1 + i % 4_000), 1);
        }
        addVehicle(1_024, 700, 1);
        vm.prank(vehicle(1_024));
        vm.expectRevert(abi.encodeWithSelector(ProposalListFull.selector, uav(0)));
        relay.submitVehSelection(uav(0), 1_000, 1);
        uint256 before = gasleft();
        check(relay.allocateZone(1, 1), "one UAV is always decided whole");
        check(before - gasleft() < 12_000_000, "gas of the longest list");
    }

    // Pieces

    function test_duringAnAllocationNoProposalIsTakenAndUAVsMayComeAndGo() public {
        for (uint256 i = 0; i < 6; ++i) {
            addUAV(i, 5_000, 1);
            addVehicle(i, 10, 1);
            if (i != 3) submit(vehicle(i), uav(i), 1_000, 1);
        }
        check(!relay.allocateZone(1, 2), "first piece");
        vm.prank(vehicle(3));
        vm.expectRevert(abi.encodeWithSelector(ZoneAllocating.selector, uint32(1)));
        relay.submitVehSelection(uav(3), 1_000, 1);
        vm.expectRevert(abi.encodeWithSelector(ZoneAllocating.selector, uint32(1)));
        relay.determineMDRLModel(1);
        // A decided one and an undecided one leave; another comes.
        vm.prank(uav(0));
        relay.updateUAVZone(uav(0), 2);
        vm.prank(uav(4));
        relay.updateUAVZone(uav(4), 0);
        addUAV(6, 5_000, 1);
        check(status(vehicle(0)) == ProposalStatus.None && status(vehicle(4)) == ProposalStatus.None, "free again");
        while (!relay.allocateZone(1, 1)) {}
        check(status(vehicle(1)) == ProposalStatus.Selected, "decided in the first piece");
        check(status(vehicle(2)) == ProposalStatus.Selected, "decided later");
        check(status(vehicle(5)) == ProposalStatus.Selected, "moved up and decided");
        equal(relay.getZoneInfo(1).selectedVehicles, 3, "selected");
        equal(zoneUAVs(1).length, 5, "list");
        for (uint256 i = 0; i < 5; ++i) {
            // Each one's place is its own: it can leave.
            address leaving = zoneUAVs(1)[0];
            vm.prank(leaving);
            relay.updateUAVZone(leaving, 0);
        }
        equal(zoneUAVs(1).length, 0, "empty");
    }

    function test_noResetVoidsWhatIsUndecidedOrHalfDecided() public {
        for (uint256 i = 0; i < 3; ++i) {
            addUAV(i, 5_000, 1);
            addVehicle(i, 10, 1);
            submit(vehicle(i), uav(i), 1_000, 1);
        }
        vm.expectRevert(abi.encodeWithSelector(ProposalsUndecided.selector, uint32(1)));
        relay.resetListsForZone(1);
        check(!relay.allocateZone(1, 1), "first piece");
        vm.expectRevert(abi.encodeWithSelector(ProposalsUndecided.selector, uint32(1)));
        relay.resetListsForZone(1);
        allocate(1);
        relay.resetListsForZone(1);
        ZoneInfo memory z = relay.getZoneInfo(1);
        check(!z.allocating && !z.waiting && z.selectedVehicles == 0 && z.selectedUAVs == 0 && z.period == 2, "reset");
        submit(vehicle(0), uav(1), 1_000, z.round);
    }

    function test_piecesNeedWork() public {
        addUAV(0, 5_000, 1);
        vm.expectRevert(NoWork.selector);
        relay.allocateZone(1, 0);
    }

    // No dangling entries

    function matched(uint32 zone) private {
        addUAV(0, 3_000, zone);
        addVehicle(0, 10, zone);
        submit(vehicle(0), uav(0), 1_000, 1);
        allocate(zone);
    }

    function test_aUAVThatRunsEmptyLeavesOrIsResetFreesItsVehicles() public {
        for (uint32 zone = 1; zone <= 3; ++zone) {
            addUAV(zone, 3_000, zone);
            addVehicle(zone, 10, zone);
            submit(vehicle(zone), uav(zone), 1_000, 1);
            allocate(zone);
            vm.prank(uav(zone));
            if (zone == 1) relay.updateUAVInfo(0, 0, 0, 0, 0);
            if (zone == 2) relay.updateUAVZone(uav(zone), 0);
            if (zone == 3) relay.resetUAVSubmission(uav(zone));
            check(status(vehicle(zone)) == ProposalStatus.None, "free");
            equal(relay.getZoneInfo(zone).selectedVehicles, 0, "vehicles");
            equal(relay.getZoneInfo(zone).selectedUAVs, 0, "UAVs");
            equal(relay.getSelectedUAVs(zone, 0, type(uint256).max).length, 0, "selected UAVs");
            addUAV(10 + zone, 3_000, zone);
            submit(vehicle(zone), uav(10 + zone), 1_000, 2);
        }
    }

    function test_aUAVThatComesBackInThePeriodHoldsNothingAndTakesNothing() public {
        matched(1);
        vm.prank(uav(0));
        relay.updateUAVZone(uav(0), 2);
        vm.prank(uav(0));
        relay.updateUAVZone(uav(0), 1);
        check(status(vehicle(0)) == ProposalStatus.None, "nothing held");
        equal(relay.getUAVInfo(uav(0)).available, 3_000, "whole bandwidth");
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(UAVClosed.selector, uav(0)));
        relay.submitVehSelection(uav(0), 1_000, 2);
        relay.resetListsForZone(1);
        submit(vehicle(0), uav(0), 1_000, round(1));
    }

    function test_aVehicleThatChangesZoneGivesItsPlaceBack() public {
        matched(1);
        addUAV(1, 3_000, 2);
        vm.prank(vehicle(0));
        relay.updateVehicleInfo(0, 0, 10, 2);
        equal(relay.getUAVInfo(uav(0)).available, 3_000, "bandwidth back");
        equal(relay.getZoneInfo(1).selectedVehicles, 0, "zone");
        check(status(vehicle(0)) == ProposalStatus.None, "free");
        submit(vehicle(0), uav(1), 1_000, 1);
        addVehicle(1, 10, 1);
        submit(vehicle(1), uav(0), 3_000, 2);
        allocate(1);
        check(status(vehicle(1)) == ProposalStatus.Selected, "its place is free");
    }

    function test_aWithdrawnOpenProposalIsNotAllocated() public {
        addUAV(0, 3_000, 1);
        addVehicle(0, 10, 1);
        addVehicle(1, 10, 1);
        submit(vehicle(0), uav(0), 1_000, 1);
        submit(vehicle(1), uav(0), 1_000, 1);
        vm.prank(vehicle(0));
        relay.updateVehicleInfo(0, 0, 10, 0);
        allocate(1);
        equal(relay.getZoneInfo(1).selectedVehicles, 1, "one");
        equal(relay.getProposals(uav(0)).length, 1, "its place is the other's");
    }

    function test_zonesInThePeriodOfTheSameNumberAreNotConfused() public {
        matched(1);
        relay.resetListsForZone(1);
        addUAV(1, 3_000, 2);
        relay.resetListsForZone(2);
        // Zone 2 is in period 2 now; the vehicle's match was in period 1 of zone 1.
        vm.prank(vehicle(0));
        relay.updateVehicleInfo(0, 0, 10, 2);
        check(status(vehicle(0)) == ProposalStatus.None, "old match");
        submit(vehicle(0), uav(1), 1_000, round(2));
    }

    function test_bandwidthMayNotFallOnceAVehicleHasProposed() public {
        addUAV(0, 3_000, 1);
        addVehicle(0, 10, 1);
        vm.prank(uav(0));
        relay.updateUAVInfo(0, 0, 0, 1, 2_000);
        submit(vehicle(0), uav(0), 1_000, 1);
        for (uint256 decided = 0; decided < 2; ++decided) {
            vm.prank(uav(0));
            vm.expectRevert(abi.encodeWithSelector(BandwidthCommitted.selector, uint32(1_999), uint32(2_000)));
            relay.updateUAVInfo(0, 0, 0, 1, 1_999);
            if (decided == 0) allocate(1);
        }
        vm.prank(uav(0));
        relay.updateUAVInfo(0, 0, 0, 1, 2_001);
        equal(relay.getUAVInfo(uav(0)).available, 1_001, "more may be offered");
        relay.resetListsForZone(1);
        vm.prank(uav(0));
        relay.updateUAVInfo(0, 0, 0, 1, 5);
    }

    function test_aUAVInItsZoneCannotEnterItAgain() public {
        addUAV(0, 3_000, 1);
        vm.prank(uav(0));
        vm.expectRevert(abi.encodeWithSelector(SameZone.selector, uint32(1)));
        relay.updateUAVZone(uav(0), 1);
    }

    // Models

    function test_modelsAreNamedByContentAndReadBack() public {
        ModelCard memory c = card(2, 5, -3_100);
        bytes32 id = relay.registerModel(CID, c);
        check(id == keccak256(abi.encode(address(this), CID, c)), "id");
        (bytes memory cid, ModelCard memory found, address owner, bool retired) = relay.getModel(id);
        check(keccak256(cid) == keccak256(CID), "cid");
        check(keccak256(abi.encode(found)) == keccak256(abi.encode(c)) && owner == address(this) && !retired, "card");
        vm.expectRevert(abi.encodeWithSelector(ModelAlreadyRegistered.selector, id));
        relay.registerModel(CID, c);
        // Another's copy has another id: it retires its own.
        address rival = address(0x77);
        relay.grantRole(relay.PUBLISHER_ROLE(), rival);
        vm.prank(rival);
        bytes32 copied = relay.registerModel(CID, c);
        check(copied != id, "a rival's copy");
        vm.prank(rival);
        relay.retireModel(copied);
        (,,, retired) = relay.getModel(id);
        check(!retired, "the owner's is in use");
    }

    function test_noScoreIsAboveWhatAReturnCanBe() public {
        relay.registerModel(CID, card(1, 5, 0));
        vm.expectRevert(InvalidCard.selector);
        relay.registerModel(CID, card(1, 5, 1));
        vm.expectRevert(InvalidCard.selector);
        relay.registerModel(CID, card(1, 5, type(int32).max));
    }

    function test_modelsThatDoNotFitAreRefused() public {
        ModelCard memory c = card(2, 5, 0);
        c.observationSide = 19;
        vm.expectRevert(abi.encodeWithSelector(ModelDoesNotFit.selector, uint16(19), uint8(6), uint8(9)));
        relay.registerModel(CID, c);
        c = card(2, 5, 0);
        c.channels = 4;
        vm.expectRevert(abi.encodeWithSelector(ModelDoesNotFit.selector, uint16(11), uint8(4), uint8(9)));
        relay.registerModel(CID, c);
        c = card(2, 5, 0);
        c.actions = 5;
        vm.expectRevert(abi.encodeWithSelector(ModelDoesNotFit.selector, uint16(11), uint8(6), uint8(5)));
        relay.registerModel(CID, c);
        vm.expectRevert(InvalidCard.selector);
        relay.registerModel(CID, card(0, 5, 0));
        vm.expectRevert(InvalidCard.selector);
        relay.registerModel(CID, card(5, 2, 0));
        c = card(2, 5, 0);
        c.minVehicles = 21;
        vm.expectRevert(InvalidCard.selector);
        relay.registerModel(CID, c);
        for (uint256 i = 0; i < 4; ++i) {
            bytes memory cid = CID;
            if (i == 1) continue; // the codec is free
            cid[i] = 0x77;
            vm.expectRevert(abi.encodeWithSelector(InvalidCID.selector, cid));
            relay.registerModel(cid, card(2, 5, 0));
        }
        bytes memory short = hex"015512";
        vm.expectRevert(abi.encodeWithSelector(InvalidCID.selector, short));
        relay.registerModel(short, card(2, 5, 0));
    }

    function test_theBestFittingModelIsAssigned() public {
        matched(1); // one UAV, one vehicle
        vm.expectRevert(NoModels.selector);
        relay.determineMDRLModel(1);
        bytes32 wide = relay.registerModel(cidOf(1), card(1, 5, -4_000));
        bytes32 better = relay.registerModel(cidOf(2), card(1, 3, -3_000));
        bytes32 equalOne = relay.registerModel(cidOf(3), card(1, 2, -3_000));
        bytes32 outside = relay.registerModel(cidOf(4), card(2, 5, 0));
        check(relay.determineMDRLModel(1) == better, "highest score, then the first");
        check(relay.getZoneInfo(1).modelId == better, "stored");
        relay.retireModel(better);
        check(relay.determineMDRLModel(1) == equalOne, "retired is out of use");
        relay.retireModel(equalOne);
        check(relay.determineMDRLModel(1) == wide, "inside goes before score");
        relay.retireModel(wide);
        check(relay.determineMDRLModel(1) == outside, "nearest outside");
        vm.expectRevert(abi.encodeWithSelector(UnknownModel.selector, wide));
        relay.retireModel(wide);
        vm.prank(vehicle(0));
        vm.expectRevert();
        relay.retireModel(outside);
        relay.resetListsForZone(1);
        check(relay.getZoneInfo(1).modelId == 0, "reset");
        vm.expectRevert(abi.encodeWithSelector(NothingSelected.selector, uint32(1)));
        relay.determineMDRLModel(1);
    }

    function test_theRegistryIsBounded() public {
        for (uint256 i = 0; i < 64; ++i) {
            relay.registerModel(cidOf(uint8(i)), card(1, 5, 0));
        }
        vm.expectRevert(abi.encodeWithSelector(TooManyModels.selector, 64));
        relay.registerModel(cidOf(64), card(1, 5, 0));
        equal(relay.modelCount(), 64, "count");
        relay.retireModel(relay.modelAt(10));
        bytes32 registered = relay.registerModel(cidOf(64), card(1, 5, 0));
        check(relay.modelAt(63) == registered, "appended");
    }

    // Reputation

    function test_theAuthoritySetsReputations() public {
        addUAV(0, 1, 0);
        addVehicle(0, 1, 0);
        address[] memory members = new address[](2);
        (members[0], members[1]) = (uav(0), vehicle(0));
        uint16[] memory values = new uint16[](2);
        (values[0], values[1]) = (10_000, 1);
        relay.setReputations(members, values);
        equal(relay.getUAVInfo(uav(0)).reputation, 10_000, "uav");
        equal(relay.getVehicleInfo(vehicle(0)).reputation, 1, "vehicle");
        values[1] = 10_001;
        vm.expectRevert(abi.encodeWithSelector(OutOfRange.selector, 10_001, 10_000));
        relay.setReputations(members, values);
        vm.expectRevert(abi.encodeWithSelector(LengthMismatch.selector, 2, 1));
        relay.setReputations(members, new uint16[](1));
    }

    function test_eachSideRatesTheOtherOnceAfterTheRound() public {
        matched(1);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(NotMatched.selector, vehicle(0), uav(0)));
        relay.rateUAV(uav(0), true); // not finished
        relay.resetListsForZone(1);
        vm.prank(vehicle(0));
        relay.rateUAV(uav(0), true);
        vm.prank(uav(0));
        relay.rateVehicle(vehicle(0), 0, false);
        equal(relay.getUAVInfo(uav(0)).reputation, 5_100, "uav");
        equal(relay.getVehicleInfo(vehicle(0)).reputation, 4_900, "vehicle");
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(NotMatched.selector, vehicle(0), uav(0)));
        relay.rateUAV(uav(0), true);
        vm.prank(uav(0));
        vm.expectRevert(abi.encodeWithSelector(NotMatched.selector, vehicle(0), uav(0)));
        relay.rateVehicle(vehicle(0), 0, false);
    }

    function test_ratingsStillOpenInTheNextPeriodAndNotForTheRejected() public {
        addUAV(0, 1_000, 1);
        addVehicle(0, 700, 1);
        addVehicle(1, 0, 1);
        addVehicle(2, 0, 1);
        submit(vehicle(0), uav(0), 1_000, 1);
        submit(vehicle(1), uav(0), 1_000, 1);
        allocate(1);
        relay.resetListsForZone(1);
        submit(vehicle(2), uav(0), 1_000, round(1));
        allocate(1);
        vm.prank(vehicle(0));
        relay.rateUAV(uav(0), false);
        equal(relay.getUAVInfo(uav(0)).reputation, 4_900, "rated a period later");
        vm.prank(vehicle(1));
        vm.expectRevert(abi.encodeWithSelector(NotMatched.selector, vehicle(1), uav(0)));
        relay.rateUAV(uav(0), false);
        vm.prank(uav(0));
        vm.expectRevert(abi.encodeWithSelector(NotMatched.selector, vehicle(2), uav(0)));
        relay.rateVehicle(vehicle(2), 0, false);
    }

    function test_selectionBitsOfAnOlderSessionAreNotRead() public {
        // Session 1 selects proposal 0, session 2 nobody; session 3 uses the list of session 2, and later that of 1.
        matched(1);
        relay.resetListsForZone(1);
        addVehicle(1, 10, 1);
        for (uint256 i = 0; i < 3; ++i) {
            submit(vehicle(1), uav(0), 4_000, round(1));
            check(status(vehicle(1)) == ProposalStatus.Pending, "pending");
            allocate(1);
            check(status(vehicle(1)) == ProposalStatus.Rejected, "does not fit");
            relay.resetListsForZone(1);
            vm.prank(vehicle(1));
            vm.expectRevert(abi.encodeWithSelector(NotMatched.selector, vehicle(1), uav(0)));
            relay.rateUAV(uav(0), true);
        }
        vm.prank(vehicle(0));
        relay.rateUAV(uav(0), true); // whom it served last can still rate it
    }

    function test_ratingsStayWithinTheirBounds() public {
        matched(1);
        address[] memory members = new address[](2);
        (members[0], members[1]) = (uav(0), vehicle(0));
        uint16[] memory values = new uint16[](2);
        (values[0], values[1]) = (9_950, 50);
        relay.setReputations(members, values);
        relay.resetListsForZone(1);
        vm.prank(vehicle(0));
        relay.rateUAV(uav(0), true);
        vm.prank(uav(0));
        relay.rateVehicle(vehicle(0), 0, false);
        equal(relay.getUAVInfo(uav(0)).reputation, 10_000, "uav");
        equal(relay.getVehicleInfo(vehicle(0)).reputation, 0, "vehicle");
    }
}

contract RatingsOffTest is Fixture {
    function parameters() internal pure override returns (Parameters memory p) {
        p = super.parameters();
        p.ratingStep = 0;
        p.rangeGate = false;
        p.observationSide = 0;
    }

    function test_ratingsCanBeSwitchedOffAndRangeOpened() public {
        deploy();
        addUAV(0, 5_000, 1);
        vm.prank(vehicle(0));
        relay.registerVehicle(type(int32).max, type(int32).min, 1, 1);
        submit(vehicle(0), uav(0), 1_000, 1);
        allocate(1);
        relay.resetListsForZone(1);
        vm.prank(vehicle(0));
        vm.expectRevert(RatingsOff.selector);
        relay.rateUAV(uav(0), true);
        vm.prank(uav(0));
        vm.expectRevert(RatingsOff.selector);
        relay.rateVehicle(vehicle(0), 0, true);
    }
}
