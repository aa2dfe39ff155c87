// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {IAccessControlDefaultAdminRules} from
    "@openzeppelin/contracts/access/extensions/IAccessControlDefaultAdminRules.sol";
import {Fixture} from "./Fixture.sol";

/// @notice What is signed off the chain, as a wallet would.
abstract contract Signing is Fixture {
    bytes32 internal constant PROPOSAL = keccak256(
        "Proposal(address uav,uint32 zone,uint32 round,int32 x,int32 y,uint32 payment,uint32 demand,uint32 since)"
    );
    bytes32 private constant VOUCHER = keccak256("Voucher(address member,uint8 kind,uint256 expires)");

    struct Offer {
        address uav;
        uint32 zone;
        uint32 round;
        int32 x;
        int32 y;
        uint32 payment;
        uint32 demand;
        uint32 since;
    }

    function digest(bytes32 hash) internal view returns (bytes32) {
        bytes32 domain = keccak256(
            abi.encode(
                keccak256("EIP712Domain(string name,string version,uint256 chainId,address verifyingContract)"),
                keccak256("SkyRelay"),
                keccak256("1"),
                block.chainid,
                address(relay)
            )
        );
        return keccak256(abi.encodePacked(hex"1901", domain, hash));
    }

    function signed(uint256 key, Offer memory o) internal view returns (SignedProposal memory) {
        bytes32 hash =
            keccak256(abi.encode(PROPOSAL, o.uav, o.zone, o.round, o.x, o.y, o.payment, o.demand, o.since));
        (uint8 v, bytes32 r, bytes32 s) = vm.sign(key, digest(hash));
        uint256 terms = uint32(o.x) | uint256(uint32(o.y)) << 32 | uint256(o.payment) << 64
            | uint256(o.demand) << 96 | uint256(o.since) << 128;
        return SignedProposal(terms, r, bytes32(uint256(s) | uint256(v - 27) << 255));
    }

    function voucher(uint256 key, address member, uint8 kind, uint256 expires) internal view returns (bytes memory) {
        (uint8 v, bytes32 r, bytes32 s) = vm.sign(key, digest(keccak256(abi.encode(VOUCHER, member, kind, expires))));
        return abi.encodePacked(r, s, v);
    }

    function handIn(address uav_, SignedProposal memory proposal) internal returns (bool) {
        SignedBatch[] memory batches = new SignedBatch[](1);
        batches[0].uav = uav_;
        batches[0].proposals = new SignedProposal[](1);
        batches[0].proposals[0] = proposal;
        return relay.submitSigned(batches) == 1;
    }
}

/// @notice Attacks on places, terms and ratings, on liveness, admission and administration.
contract RulesTest is Signing {
    function setUp() public {
        deploy();
        vm.warp(1_000);
    }

    function matched() private {
        addUAV(0, 3_000, 1);
        addVehicle(0, 10, 1);
        submit(vehicle(0), uav(0), 1_000, 1);
        allocate(1);
    }

    function move(uint256 i, uint32 zone) private {
        vm.prank(vehicle(i));
        relay.updateVehicleInfo(int32(int256(i)), 0, 10, zone);
    }

    // Places

    function test_oneVehicleThatComesAndGoesHoldsOnePlace() public {
        addUAV(0, 20_000, 1);
        addVehicle(0, 10, 1);
        for (uint256 i = 0; i < 1_100; ++i) {
            submit(vehicle(0), uav(0), 1_000, 1);
            move(0, 0);
            move(0, 1);
        }
        equal(relay.getProposals(uav(0)).length, 0, "places");
        addVehicle(1, 10, 1);
        submit(vehicle(1), uav(0), 1_000, 1);
        equal(relay.getProposals(uav(0)).length, 1, "the other's");
    }

    function test_throughRoundsToOneHoldsOnePlace() public {
        addUAV(0, 20_000, 1);
        addVehicle(0, 10, 1);
        for (uint32 i = 1; i <= 1_100; ++i) {
            submit(vehicle(0), uav(0), 1_000, i);
            allocate(1);
            move(0, 0);
            move(0, 1);
        }
        // 1,024 others still find room, and those who went are not served.
        for (uint256 i = 1; i <= 1_024; ++i) {
            addVehicle(i, 10, 1);
            submit(vehicle(i), uav(0), 1_000, 1_101);
        }
        uint256 before = gasleft();
        allocate(1);
        check(before - gasleft() < 12_000_000, "gas of the longest list");
        equal(relay.getZoneInfo(1).selectedVehicles, 20, "served");
    }

    function testFuzz_whoeverLeavesTheListStaysSound(uint256 seed) public {
        addUAV(0, 4_000, 1);
        for (uint256 i = 0; i < 12; ++i) {
            addVehicle(i, uint32(i), 1);
            submit(vehicle(i), uav(0), 1_000, 1);
        }
        bool[12] memory gone;
        for (uint256 i = 0; i < 8; ++i) {
            uint256 leaving = uint256(keccak256(abi.encode(seed, i))) % 12;
            gone[leaving] = true;
            move(leaving, 2);
            VehicleSelection[] memory list = relay.getProposals(uav(0));
            for (uint256 k = 0; k < list.length; ++k) {
                (ProposalStatus found, address to, uint16 index) = relay.getVehicleSelection(list[k].vehicle);
                check(found == ProposalStatus.Pending && to == uav(0) && index == k, "each knows its place");
            }
        }
        allocate(1);
        uint256 served;
        for (uint256 i = 0; i < 12; ++i) {
            bool selected = status(vehicle(i)) == ProposalStatus.Selected;
            check(!selected || !gone[i], "one that left is served");
            if (selected) ++served;
        }
        equal(relay.getZoneInfo(1).selectedVehicles, served, "count");
    }

    // Terms

    function test_termsAreFrozenWhileAProposalIsOpenOrAccepted() public {
        addUAV(0, 1_000, 1);
        address baiter = addVehicle(0, 700, 1);
        address honest = addVehicle(1, 699, 1);
        submit(baiter, uav(0), 1_000, 1);
        submit(honest, uav(0), 1_000, 1);
        for (uint256 decided = 0; decided < 2; ++decided) {
            vm.prank(baiter);
            vm.expectRevert(abi.encodeWithSelector(TermsFrozen.selector, baiter));
            relay.updateVehicleInfo(29_000, 0, 0, 1);
            if (decided == 0) allocate(1);
        }
        check(status(baiter) == ProposalStatus.Selected, "at its own terms");
        equal(relay.getVehicleInfo(baiter).payment, 700, "which it still offers");
        // Who was rejected is free, and who leaves gives it up.
        vm.prank(honest);
        relay.updateVehicleInfo(0, 0, 1, 1);
        move(0, 2);
        check(status(baiter) == ProposalStatus.None, "given up");
        equal(relay.getUAVInfo(uav(0)).available, 1_000, "bandwidth");
        relay.resetListsForZone(1);
        move(0, 1);
    }

    // Ratings

    function test_aResetDoesNotKeepAUAVFromBeingRated() public {
        matched();
        vm.prank(uav(0));
        relay.resetUAVSubmission(uav(0));
        // Nor do an accomplice's proposals, in this period or in the next, that lead to nothing.
        relay.resetListsForZone(1);
        addVehicle(1, 10, 1);
        for (uint256 i = 0; i < 3; ++i) {
            submit(vehicle(1), uav(0), 1_000, round(1));
            vm.prank(uav(0));
            relay.resetUAVSubmission(uav(0));
            allocate(1);
            relay.resetListsForZone(1);
        }
        vm.prank(vehicle(0));
        relay.rateUAV(uav(0), false);
        equal(relay.getUAVInfo(uav(0)).reputation, 4_900, "rated");
    }

    function test_aVehicleThatLeavesIsStillRated() public {
        matched();
        move(0, 2);
        // Through another allocation that the same session goes through.
        addVehicle(1, 10, 1);
        submit(vehicle(1), uav(0), 1_000, round(1));
        allocate(1);
        relay.resetListsForZone(1);
        vm.prank(uav(0));
        relay.rateVehicle(vehicle(0), 0, false);
        equal(relay.getVehicleInfo(vehicle(0)).reputation, 4_900, "rated");
        vm.prank(uav(0));
        vm.expectRevert(abi.encodeWithSelector(NotMatched.selector, vehicle(0), uav(0)));
        relay.rateVehicle(vehicle(0), 0, false);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(NotMatched.selector, vehicle(0), uav(0)));
        relay.rateUAV(uav(0), false);
    }

    // Liveness

    function begunAllocation() private {
        for (uint256 i = 0; i < 3; ++i) {
            addUAV(i, 5_000, 1);
            addVehicle(i, 10, 1);
            submit(vehicle(i), uav(i), 1_000, 1);
        }
    }

    function test_anyoneFinishesAnAllocationThatHasBegun() public {
        begunAllocation();
        address anyone = address(0x51);
        check(!relay.allocateZone(1, 1), "first piece");
        vm.prank(anyone);
        check(relay.allocateZone(1, 10), "the rest");
        equal(relay.getZoneInfo(1).selectedVehicles, 3, "all");
        bytes memory refusal = abi.encodeWithSelector(
            IAccessControl.AccessControlUnauthorizedAccount.selector, anyone, relay.COORDINATOR_ROLE()
        );
        vm.prank(anyone);
        vm.expectRevert(refusal);
        relay.allocateZone(1, 10);
    }

    function test_anyoneAllocatesAfterTheDeadlineAndNotBefore() public {
        begunAllocation();
        address anyone = address(0x51);
        vm.warp(1_060);
        bytes memory refusal = abi.encodeWithSelector(
            IAccessControl.AccessControlUnauthorizedAccount.selector, anyone, relay.COORDINATOR_ROLE()
        );
        vm.prank(anyone);
        vm.expectRevert(refusal);
        relay.allocateZone(1, 10);
        vm.warp(1_061);
        vm.prank(anyone);
        check(relay.allocateZone(1, 10), "late");
        // A round without proposals is not anyone's to close, however long it lasts.
        vm.warp(9_000);
        vm.prank(anyone);
        vm.expectRevert(refusal);
        relay.allocateZone(1, 10);
        // Nor is the period, which has no stated length here; the model is, once.
        vm.prank(anyone);
        vm.expectRevert(refusal);
        relay.resetListsForZone(1);
        relay.registerModel(hex"0155122000112233445566778899aabbccddeeff00112233445566778899aabbccddeeff", ModelCard(1, 5, 1, 20, 11, 6, 9, -3_000));
        vm.prank(anyone);
        relay.determineMDRLModel(1);
        vm.prank(anyone);
        vm.expectRevert(refusal);
        relay.determineMDRLModel(1);
    }

    function test_aZoneWithACoordinatorOfItsOwnIsNobodyElses() public {
        matched();
        addUAV(1, 3_000, 2);
        address own = address(0x61);
        relay.setZoneCoordinator(1, own);
        bytes memory refusal = abi.encodeWithSelector(NotCoordinator.selector, uint32(1), address(this));
        vm.expectRevert(refusal);
        relay.allocateZone(1, 10);
        vm.expectRevert(refusal);
        relay.resetListsForZone(1);
        vm.expectRevert(refusal);
        relay.determineMDRLModel(1);
        vm.prank(own);
        relay.resetListsForZone(1);
        refusal = abi.encodeWithSelector(
            IAccessControl.AccessControlUnauthorizedAccount.selector, own, relay.COORDINATOR_ROLE()
        );
        vm.prank(own);
        vm.expectRevert(refusal);
        relay.resetListsForZone(2);
        relay.setZoneCoordinator(1, address(0));
        relay.resetListsForZone(1);
    }

    // Who takes part

    function test_aUAVNotHeardOfTakesNothingAndIsResetByAnyone() public {
        addUAV(0, 3_000, 1);
        addVehicle(0, 10, 1);
        addVehicle(1, 10, 1);
        submit(vehicle(0), uav(0), 1_000, 1);
        vm.prank(vehicle(1));
        vm.expectRevert(abi.encodeWithSelector(NotOwnRecord.selector, uav(0), vehicle(1)));
        relay.resetUAVSubmission(uav(0));
        vm.warp(1_000 + 3_601);
        vm.prank(vehicle(1));
        vm.expectRevert(abi.encodeWithSelector(UAVStale.selector, uav(0), uint256(1_000)));
        relay.submitVehSelection(uav(0), 1_000, 1);
        vm.prank(vehicle(1));
        relay.resetUAVSubmission(uav(0));
        check(status(vehicle(0)) == ProposalStatus.None, "free");
        allocate(1);
        relay.resetListsForZone(1);
        vm.prank(uav(0));
        relay.updateUAVInfo(0, 0, 0, 1, 3_000);
        submit(vehicle(1), uav(0), 1_000, round(1));
    }

    function test_suspendedMembersAndZonesTakeNoPart() public {
        matched();
        addUAV(1, 3_000, 1);
        addVehicle(1, 10, 1);
        relay.suspendMember(vehicle(0), true);
        check(status(vehicle(0)) == ProposalStatus.None, "its selection is void");
        equal(relay.getUAVInfo(uav(0)).available, 3_000, "its bandwidth is free");
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(Suspended.selector, vehicle(0)));
        relay.submitVehSelection(uav(1), 1_000, 2);
        submit(vehicle(1), uav(0), 1_000, 2);
        relay.suspendMember(uav(0), true);
        check(status(vehicle(1)) == ProposalStatus.None, "void");
        vm.prank(vehicle(1));
        vm.expectRevert(abi.encodeWithSelector(Suspended.selector, uav(0)));
        relay.submitVehSelection(uav(0), 1_000, 2);
        relay.suspendZone(1, true);
        vm.prank(vehicle(1));
        vm.expectRevert(abi.encodeWithSelector(SuspendedZone.selector, uint32(1)));
        relay.submitVehSelection(uav(1), 1_000, 2);
        relay.suspendZone(1, false);
        relay.suspendMember(vehicle(0), false);
        submit(vehicle(0), uav(1), 1_000, 2);
        vm.expectRevert(abi.encodeWithSelector(UnknownMember.selector, address(0x99)));
        relay.suspendMember(address(0x99), true);
        bytes memory refusal = abi.encodeWithSelector(
            IAccessControl.AccessControlUnauthorizedAccount.selector, vehicle(1), relay.REGISTRAR_ROLE()
        );
        vm.prank(vehicle(1));
        vm.expectRevert(refusal);
        relay.suspendMember(vehicle(0), true);
        vm.prank(vehicle(1));
        vm.expectRevert(refusal);
        relay.suspendZone(1, true);
    }

    // Administration

    function test_anotherAdministratorTakesADelayAndBothKeys() public {
        address next = address(0x71);
        bytes32 role = bytes32(0);
        vm.expectRevert(IAccessControlDefaultAdminRules.AccessControlEnforcedDefaultAdminRules.selector);
        relay.grantRole(role, next);
        relay.beginDefaultAdminTransfer(next);
        vm.warp(1_000 + 1 days);
        vm.prank(next);
        vm.expectRevert();
        relay.acceptDefaultAdminTransfer();
        relay.cancelDefaultAdminTransfer();
        vm.warp(1_000 + 2 days);
        vm.prank(next);
        vm.expectRevert();
        relay.acceptDefaultAdminTransfer();
        relay.beginDefaultAdminTransfer(next);
        vm.warp(1_001 + 3 days);
        vm.expectRevert();
        relay.acceptDefaultAdminTransfer(); // the old key alone
        vm.prank(next);
        relay.acceptDefaultAdminTransfer();
        check(relay.hasRole(role, next) && !relay.hasRole(role, address(this)), "changed");
        equal(relay.defaultAdminDelay(), 1 days, "delay");
        vm.prank(next);
        vm.expectRevert(AdminDelayFixed.selector);
        relay.changeDefaultAdminDelay(0);
    }

    function test_nobodyInitialisesAgain() public {
        vm.expectRevert(InvalidParameters.selector);
        relay.initialise(address(this));
        address alone = newExtension(parameters());
        (bool done,) = alone.call(abi.encodeCall(relay.initialise, (address(this))));
        check(!done, "the extension alone");
    }

    // Signed proposals

    function offer(uint256 payment, uint256 since) private view returns (Offer memory) {
        return Offer(uav(0), 1, round(1), 5, -7, uint32(payment), 1_000, uint32(since));
    }

    function signer(uint256 key) private returns (address member) {
        member = vm.addr(key);
        vm.prank(member);
        relay.registerVehicle(0, 0, 1, 0);
    }

    function test_anyoneHandsInWhatAVehicleHasSigned() public {
        addUAV(0, 3_000, 1);
        address member = signer(11);
        vm.warp(1_500);
        vm.prank(address(0x51));
        check(handIn(uav(0), signed(11, offer(321, 1_000))), "taken");
        VehicleInfo memory v = relay.getVehicleInfo(member);
        check(v.x == 5 && v.y == -7 && v.payment == 321 && v.zone == 1 && v.timestamp == 1_500, "record");
        (uint64 qov, uint64 score) = relay.quality(member, uav(0), 1_000);
        check(qov != 0 && relay.getProposals(uav(0))[0].score == score, "as if it had done so itself");
        allocate(1);
        check(status(member) == ProposalStatus.Selected, "selected");
    }

    function test_whatWasSignedCountsOnceAndForNothingElse() public {
        addUAV(0, 3_000, 1);
        addUAV(1, 3_000, 1);
        address member = signer(11);
        Offer memory o = offer(321, 1_000);
        SignedProposal memory p = signed(11, o);
        check(!handIn(uav(1), p), "another UAV");
        SignedProposal memory changed = SignedProposal(p.terms ^ 1, p.r, p.vs);
        check(!handIn(uav(0), changed), "other terms");
        check(!handIn(uav(0), signed(12, o)), "nobody's signature");
        check(!handIn(uav(0), SignedProposal(p.terms, 0, p.vs)), "no signature");
        o.payment = 701;
        check(!handIn(uav(0), signed(11, o)), "too much");
        o.payment = 1;
        o.demand = 4_001;
        check(!handIn(uav(0), signed(11, o)), "too much");
        check(handIn(uav(0), p), "taken");
        check(!handIn(uav(0), p), "twice");
        vm.prank(member);
        relay.updateVehicleInfo(0, 0, 1, 0); // it withdraws
        check(!handIn(uav(0), p), "after it was withdrawn");
        allocate(1);
        check(!handIn(uav(0), p), "in another round");
        equal(relay.getProposals(uav(0)).length, 0, "nothing");
    }

    function test_whoLeftAfterARejectionComesBackToIt() public {
        addUAV(0, 500, 1);
        addUAV(1, 3_000, 1);
        addUAV(2, 3_000, 2);
        address member = signer(11);
        check(handIn(uav(0), signed(11, offer(321, 1_000))), "taken");
        allocate(1);
        check(status(member) == ProposalStatus.Rejected, "rejected");
        vm.prank(member);
        relay.updateVehicleInfo(0, 0, 1, 2);
        check(status(member) == ProposalStatus.None, "nothing in the zone that it goes to");
        uint256 since = relay.getVehicleInfo(member).timestamp;
        check(!handIn(uav(0), signed(11, offer(321, since))), "by a signature");
        vm.prank(member);
        relay.updateVehicleInfo(0, 0, 1, 1);
        uint32 now_ = round(1);
        vm.prank(member);
        vm.expectRevert(abi.encodeWithSelector(AlreadyRejected.selector, member, uav(0)));
        relay.submitVehSelection(uav(0), 400, now_); // by a transaction
        vm.prank(member);
        relay.updateVehicleInfo(0, 0, 1, 2);
        Offer memory other = offer(321, relay.getVehicleInfo(member).timestamp);
        other.uav = uav(1);
        check(handIn(uav(1), signed(11, other)), "another UAV of the zone");
    }

    function test_whatIsOpenElsewhereStaysOpen() public {
        addUAV(0, 3_000, 1);
        addUAV(1, 3_000, 2);
        address member = signer(11);
        check(handIn(uav(0), signed(11, offer(321, 1_000))), "taken");
        Offer memory other = offer(1, relay.getVehicleInfo(member).timestamp);
        (other.uav, other.zone, other.round) = (uav(1), 2, round(2));
        check(!handIn(uav(1), signed(11, other)), "a second one, in another zone");
        allocate(1);
        check(status(member) == ProposalStatus.Selected, "selected");
        check(!handIn(uav(1), signed(11, other)), "beside a selection");
    }

    function test_oneThatIsRefusedDoesNotSpoilABatch() public {
        addUAV(0, 20_000, 1);
        SignedBatch[] memory batches = new SignedBatch[](1);
        batches[0] = SignedBatch(uav(0), new SignedProposal[](20));
        for (uint256 i = 0; i < 20; ++i) {
            if (i % 3 != 0) signer(100 + i); // the others are no members
            batches[0].proposals[i] = signed(100 + i, offer(i, 1_000));
        }
        vm.prank(address(0x51));
        equal(relay.submitSigned(batches), 13, "taken");
        equal(relay.getProposals(uav(0)).length, 13, "in the list");
    }
}

contract AdmissionTest is Signing {
    uint256 private constant REGISTRAR = 77;

    function parameters() internal pure override returns (Parameters memory p) {
        p = super.parameters();
        p.admission = true;
        p.minimumPeriod = 600;
    }

    function setUp() public {
        deploy();
        vm.warp(1_000);
        relay.grantRole(relay.REGISTRAR_ROLE(), vm.addr(REGISTRAR));
    }

    function admit(address member, uint8 kind) private {
        relay.admit(member, kind, 2_000, voucher(REGISTRAR, member, kind, 2_000));
    }

    function test_onlyWhoWasAdmittedRegistersAndAsThat() public {
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(NotAdmitted.selector, vehicle(0)));
        relay.registerVehicle(0, 0, 1, 1);
        admit(vehicle(0), 2);
        vm.prank(vehicle(0));
        vm.expectRevert(abi.encodeWithSelector(NotAdmitted.selector, vehicle(0)));
        relay.registerUAV(0, 0, 0, 1, 1, 1);
        addVehicle(0, 1, 1);
        admit(uav(0), 1);
        addUAV(0, 5_000, 1);
        vm.expectRevert(abi.encodeWithSelector(AlreadyRegistered.selector, uav(0)));
        admit(uav(0), 1);
        submit(vehicle(0), uav(0), 1_000, 1);
    }

    function test_vouchersAreTheRegistrarsForOneMemberAndATime() public {
        bytes memory good = voucher(REGISTRAR, vehicle(0), 2, 2_000);
        vm.expectRevert(InvalidVoucher.selector);
        relay.admit(vehicle(1), 2, 2_000, good);
        vm.expectRevert(InvalidVoucher.selector);
        relay.admit(vehicle(0), 1, 2_000, good);
        vm.expectRevert(InvalidVoucher.selector);
        relay.admit(vehicle(0), 2, 3_000, good);
        bytes memory strangers = voucher(78, vehicle(0), 2, 2_000);
        vm.expectRevert(InvalidVoucher.selector);
        relay.admit(vehicle(0), 2, 2_000, strangers);
        bytes memory noKind = voucher(REGISTRAR, vehicle(0), 3, 2_000);
        vm.expectRevert(InvalidVoucher.selector);
        relay.admit(vehicle(0), 3, 2_000, noKind);
        vm.warp(2_001);
        vm.expectRevert(InvalidVoucher.selector);
        relay.admit(vehicle(0), 2, 2_000, good);
    }

    function test_aPeriodEndsWhenItIsDueAndThenByAnyone() public {
        admit(uav(0), 1);
        admit(vehicle(0), 2);
        addUAV(0, 5_000, 1);
        addVehicle(0, 1, 1);
        submit(vehicle(0), uav(0), 1_000, 1);
        allocate(1);
        vm.warp(1_599);
        vm.expectRevert(abi.encodeWithSelector(PeriodNotDue.selector, uint32(1), uint256(1_600)));
        relay.resetListsForZone(1);
        vm.warp(1_601);
        vm.prank(vehicle(0));
        relay.resetListsForZone(1); // 600 s of the period and 60 s after the allocation are over
        equal(relay.getZoneInfo(1).period, 2, "period");
        vm.warp(2_201);
        relay.resetListsForZone(1);
    }
}

contract OpenTest is Signing {
    function test_whereAnyoneMayRegisterThereIsNothingToAdmit() public {
        deploy();
        vm.expectRevert(AdmissionOpen.selector);
        relay.admit(vehicle(0), 2, 2_000, new bytes(65));
    }
}
