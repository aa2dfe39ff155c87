// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {IOptimisticSelection} from "../src/interfaces/IOptimisticSelection.sol";
import {Member} from "../src/libraries/Records.sol";
import {IRelay} from "./Fixture.sol";
import {Test} from "./Vm.sol";
import {Signing} from "./Rules.t.sol";

interface IClaims is IOptimisticSelection, IERC20 {}

/// @notice A SkyRelay with claims, and one without, which has the same members and says what is right.
abstract contract Claiming is Signing {
    uint256 internal constant BOND = 100;
    uint256 internal constant SUPPLY = 1_000;
    uint256 internal constant WINDOW = 10;

    IClaims internal claims;
    IRelay internal strict;
    /// @dev What has been claimed so far, as a challenger shows it again.
    IOptimisticSelection.Round[] internal shown;

    function parameters() internal pure override returns (Parameters memory p) {
        p = super.parameters();
        p.settling = uint32(3 * WINDOW);
    }

    function deployBoth() internal {
        deploy();
        strict = relay;
        deploy();
        claims = IClaims(newClaims(parameters(), BOND, SUPPLY));
        vm.warp(1_000);
        vm.roll(1_000);
    }

    function onBoth(address member, bytes memory data) internal {
        vm.prank(member);
        (bool first,) = address(relay).call(data);
        vm.prank(member);
        (bool second,) = address(strict).call(data);
        check(first && second, "both take it");
    }

    function addPair(uint256 uavs, uint256 keys, uint32 bandwidth) internal {
        for (uint256 i = 0; i < uavs; ++i) {
            onBoth(uav(i), abi.encodeCall(relay.registerUAV, (int32(int256(i)), 0, 100, 9_000, bandwidth, 1)));
        }
        for (uint256 key = 1; key <= keys; ++key) {
            onBoth(vm.addr(key), abi.encodeCall(relay.registerVehicle, (0, 0, 10, 1)));
        }
    }

    /// @dev A vehicle proposes: by signature to the one, by transaction to the other.
    function proposeTo(address to, uint256 key, uint32 payment, uint32 demand)
        internal
        returns (SignedProposal memory proposal)
    {
        proposal = signed(key, Offer(to, 1, round(1), 5, -5, payment, demand, 0));
        uint32 now_ = strict.getZoneInfo(1).round;
        vm.prank(vm.addr(key));
        strict.updateVehicleInfo(5, -5, payment, 1);
        vm.prank(vm.addr(key));
        strict.submitVehSelection(to, demand, now_);
    }

    function share(address of_, uint256 before, uint256 selected, SignedProposal[] memory proposals)
        internal
        pure
        returns (IOptimisticSelection.Share memory s)
    {
        s.uav = of_;
        s.before = before;
        s.selected = selected;
        s.proposals = proposals;
    }

    function one(SignedProposal memory proposal) internal pure returns (SignedProposal[] memory list) {
        list = new SignedProposal[](1);
        list[0] = proposal;
    }

    /// @dev What the contract without claims selects, as bits.
    function right(address of_) internal view returns (uint256 bits) {
        VehicleSelection[] memory all = strict.getProposals(of_);
        for (uint256 i = 0; i < all.length; ++i) {
            if (all[i].status == ProposalStatus.Selected) bits |= 1 << i;
        }
    }

    function claim(IOptimisticSelection.Share[] memory list) internal {
        claimAsOf(list, asOf());
    }

    function asOf() internal view returns (uint48 number) {
        (, , number, ,) = claims.claims(1, relay.getZoneInfo(1).period);
        if (number == 0) number = uint48(block.number - 1);
    }

    function claimAsOf(IOptimisticSelection.Share[] memory list, uint48 number) internal {
        IOptimisticSelection.Round storage r = shown.push();
        r.round = round(1);
        address[] memory one_ = new address[](1);
        for (uint256 i = 0; i < list.length; ++i) {
            one_[0] = list[i].uav;
            Member record = relay.recordsAt(one_, block.number)[0].offered();
            bytes memory packed = "";
            for (uint256 k = 0; k < list[i].proposals.length; ++k) {
                SignedProposal memory p = list[i].proposals[k];
                packed = bytes.concat(packed, bytes32(p.terms), p.r, p.vs);
            }
            bytes32 hash =
                keccak256(abi.encode(record, list[i].selected, list[i].before, keccak256(packed)));
            r.leaves.push(IOptimisticSelection.Leaf(list[i].uav, hash));
            store(r.round, list[i], record);
        }
        claims.claim(1, r.round, number, list);
    }

    mapping(uint32 round => mapping(address uav => IOptimisticSelection.Share share)) private _shares;
    mapping(uint32 round => mapping(address uav => Member record)) private _records;

    function store(uint32 round_, IOptimisticSelection.Share memory s, Member record) private {
        IOptimisticSelection.Share storage kept = _shares[round_][s.uav];
        (kept.uav, kept.selected, kept.before) = (s.uav, s.selected, s.before);
        delete kept.proposals;
        for (uint256 i = 0; i < s.proposals.length; ++i) {
            kept.proposals.push(s.proposals[i]);
        }
        _records[round_][s.uav] = record;
    }

    /// @dev A UAV's part of the first rounds of what has been claimed.
    function part(address of_, uint256 rounds) internal view returns (IOptimisticSelection.Part memory p) {
        p.uav = of_;
        p.rounds = new IOptimisticSelection.Round[](rounds);
        for (uint256 i = 0; i < rounds; ++i) {
            p.rounds[i].round = shown[i].round;
            p.rounds[i].leaves = shown[i].leaves;
            p.rounds[i].share = _shares[shown[i].round][of_];
            p.rounds[i].record = _records[shown[i].round][of_];
        }
    }

    function shares(IOptimisticSelection.Share memory s) internal pure returns (IOptimisticSelection.Share[] memory list) {
        list = new IOptimisticSelection.Share[](1);
        list[0] = s;
    }

    function state(uint32 period) internal view returns (IOptimisticSelection.State found) {
        (found,,,,) = claims.claims(1, period);
    }

    address internal constant CHALLENGER = address(0xc4a11);

    function proveWrong(address of_, uint256 rounds) internal {
        IOptimisticSelection.Part memory p = part(of_, rounds);
        vm.prank(CHALLENGER);
        claims.challenge(1, 1, p);
    }

    function expectHolds(address of_, uint256 rounds) internal {
        IOptimisticSelection.Part memory p = part(of_, rounds);
        vm.expectRevert(IOptimisticSelection.ClaimHolds.selector);
        claims.challenge(1, 1, p);
    }
}

/// @notice Attacks on claims, and by them.
contract OptimisticTest is Claiming {
    function setUp() public {
        deployBoth();
        addPair(3, 12, 3_000);
    }

    /// @dev One vehicle asks UAV 0 and is served.
    function honest() private returns (SignedProposal memory proposal) {
        proposal = proposeTo(uav(0), 1, 100, 1_000);
        claim(shares(share(uav(0), 0, 1, one(proposal))));
    }

    function test_aClaimSettlesTheZone() public {
        honest();
        ZoneInfo memory z = relay.getZoneInfo(1);
        equal(z.selectedUAVs, 1, "UAVs");
        equal(z.selectedVehicles, 1, "vehicles");
        equal(z.round, 2, "round");
        equal(claims.balanceOf(address(this)), SUPPLY - BOND, "bond taken");
        vm.prank(vm.addr(2));
        vm.expectRevert(abi.encodeWithSelector(ZoneClaimed.selector, 1));
        relay.submitVehSelection(uav(0), 1_000, 2);
        expectHolds(uav(0), 1);
    }

    /// @dev Whatever vehicles ask for, in two rounds: a claim of what SkyRelay itself selects holds, of anything else it falls.
    /// forge-config: default.fuzz.runs = 64
    function testFuzz_claimsHoldWhereTheyAreWhatIsSelected(uint256 seed, uint256 flip) public {
        SignedProposal[][] memory proposals = new SignedProposal[][](2);
        for (uint256 u = 0; u < 2; ++u) {
            proposals[u] = new SignedProposal[](5);
            for (uint256 i = 0; i < 5; ++i) {
                seed = uint256(keccak256(abi.encode(seed)));
                proposals[u][i] = proposeTo(
                    uav(u), 1 + 5 * u + i, uint32(seed % 701), uint32(500 + (seed >> 32) % 2_500)
                );
            }
        }
        strict.allocateZone(1, 1_000);
        IOptimisticSelection.Share[] memory list = new IOptimisticSelection.Share[](2);
        list[0] = share(uav(0), 0, right(uav(0)), proposals[0]);
        list[1] = share(uav(1), 0, right(uav(1)), proposals[1]);
        claim(list);

        SignedProposal[] memory more = new SignedProposal[](2);
        more[0] = proposeTo(uav(0), 11, uint32(seed >> 64) % 701, 700);
        more[1] = proposeTo(uav(0), 12, uint32(seed >> 96) % 701, 1_400);
        strict.allocateZone(1, 1_000);
        uint256 wrong = flip % 3 == 0 ? 0 : 1 << flip % 7;
        uint256 served = relay.getZoneInfo(1).selectedVehicles - list[1].selected % 2 - list[1].selected / 2 % 2
            - list[1].selected / 4 % 2 - list[1].selected / 8 % 2 - list[1].selected / 16 % 2;
        claim(shares(share(uav(0), served, right(uav(0)) ^ wrong, more)));

        expectHolds(uav(1), 2);
        expectHolds(uav(0), 1);
        if (wrong == 0) {
            expectHolds(uav(0), 2);
            equal(relay.getZoneInfo(1).selectedVehicles, strict.getZoneInfo(1).selectedVehicles, "vehicles");
            equal(relay.getZoneInfo(1).selectedUAVs, strict.getZoneInfo(1).selectedUAVs, "UAVs");
        } else {
            proveWrong(uav(0), 2);
            equal(claims.balanceOf(CHALLENGER), BOND / 2, "the cheat's bond");
        }
    }

    function test_aWrongUAVCostsTheBondAndTheStrictWayIsOpen() public {
        SignedProposal[] memory both = new SignedProposal[](2);
        both[0] = proposeTo(uav(0), 1, 700, 2_000);
        both[1] = proposeTo(uav(0), 2, 100, 2_000);
        claim(shares(share(uav(0), 0, 2, both))); // the worse one
        proveWrong(uav(0), 1);
        equal(claims.balanceOf(CHALLENGER), BOND / 2, "the challenger's");
        equal(relay.getZoneInfo(1).selectedVehicles, 0, "nobody is selected");
        check(state(1) == IOptimisticSelection.State.Void, "void");

        vm.prank(vm.addr(1));
        relay.submitVehSelection(uav(0), 2_000, 2);
        allocate(1);
        check(status(vm.addr(1)) == ProposalStatus.Selected, "selected by the strict way");

        // No other claim in this period; the next one may have some.
        relay.resetListsForZone(1);
        delete shown;
        claim(shares(share(uav(0), 0, 1, one(proposeAgain(3)))));
    }

    function proposeAgain(uint256 key) private view returns (SignedProposal memory) {
        return signed(key, Offer(uav(0), 1, round(1), 5, -5, 10, 100, 0));
    }

    function test_aVoidPeriodTakesNoOtherClaim() public {
        test_claimOfNobody();
        SignedProposal memory proposal = proposeAgain(3);
        IOptimisticSelection.Share[] memory list = shares(share(uav(0), 0, 1, one(proposal)));
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotYourPeriod.selector, 1, 1));
        claims.claim(1, 2, uint48(block.number - 1), list);
    }

    function test_claimOfNobody() public {
        claim(shares(share(uav(0), 0, 0, one(proposeTo(uav(0), 1, 100, 1_000)))));
        proveWrong(uav(0), 1);
    }

    function test_aForgedSignatureIsProved() public {
        SignedProposal memory forged = proposeTo(uav(0), 1, 100, 1_000);
        forged.terms += 1 << 64; // pays one cent more than the vehicle signed
        claim(shares(share(uav(0), 0, 1, one(forged))));
        proveWrong(uav(0), 1);
    }

    function test_proposalsThatWouldBeRefusedAreProved() public {
        Offer[6] memory bad = [
            Offer(uav(0), 1, 1, 5, -5, 701, 1_000, 0), // pays more than is allowed
            Offer(uav(0), 1, 1, 5, -5, 100, 4_001, 0),
            Offer(uav(0), 1, 1, 5, -5, 100, 0, 0),
            Offer(uav(0), 1, 1, 40_000, 0, 100, 1_000, 0), // too far
            Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 7), // for submitSigned
            Offer(uav(0), 1, 2, 5, -5, 100, 1_000, 0) // for another round
        ];
        for (uint256 i = 0; i < bad.length; ++i) {
            setUpAgain();
            claim(shares(share(uav(0), 0, bad[i].demand == 0 ? 0 : 1, one(signed(1, bad[i])))));
            proveWrong(uav(0), 1);
        }
        setUpAgain();
        claim(shares(share(uav(0), 0, 1, one(signed(99, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0)))))); // no vehicle
        proveWrong(uav(0), 1);
        setUpAgain();
        relay.suspendMember(vm.addr(1), true);
        vm.roll(block.number + 1);
        claim(shares(share(uav(0), 0, 1, one(signed(1, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0))))));
        proveWrong(uav(0), 1);
    }

    function setUpAgain() private {
        delete shown;
        setUp();
    }

    function test_oneVehicleAtTwoUAVsIsProved() public {
        IOptimisticSelection.Share[] memory list = new IOptimisticSelection.Share[](2);
        list[0] = share(uav(0), 0, 1, one(signed(1, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0))));
        list[1] = share(uav(1), 0, 1, one(signed(1, Offer(uav(1), 1, 1, 5, -5, 100, 1_000, 0))));
        claim(list);
        expectHolds(uav(0), 1); // each alone is right
        expectHolds(uav(1), 1);
        IOptimisticSelection.Part memory first = part(uav(0), 1);
        IOptimisticSelection.Part memory second = part(uav(1), 1);
        vm.prank(CHALLENGER);
        claims.challengeTwice(1, 1, first, 0, second, 0);
        equal(claims.balanceOf(CHALLENGER), BOND / 2, "the challenger's");
    }

    function test_oneVehicleTwiceAtOneUAVIsProved() public {
        SignedProposal[] memory both = new SignedProposal[](2);
        both[0] = signed(1, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0));
        both[1] = signed(1, Offer(uav(0), 1, 1, 5, -5, 200, 1_000, 0));
        claim(shares(share(uav(0), 0, 3, both)));
        IOptimisticSelection.Part memory p = part(uav(0), 1);
        vm.expectRevert(IOptimisticSelection.ClaimHolds.selector);
        claims.challengeTwice(1, 1, p, 1, p, 1);
        claims.challengeTwice(1, 1, p, 0, p, 1);
    }

    function test_aSecondProposalWhileServedIsProvedAndAfterARejectionHolds() public {
        SignedProposal[] memory both = new SignedProposal[](2);
        both[0] = signed(1, Offer(uav(0), 1, 1, 5, -5, 700, 2_000, 0));
        both[1] = signed(2, Offer(uav(0), 1, 1, 5, -5, 100, 2_000, 0)); // rejected
        claim(shares(share(uav(0), 0, 1, both)));
        SignedProposal[] memory next = new SignedProposal[](2);
        next[0] = signed(1, Offer(uav(1), 1, 2, 5, -5, 700, 1_000, 0)); // served by UAV 0
        next[1] = signed(2, Offer(uav(1), 1, 2, 5, -5, 100, 1_000, 0));
        claim(shares(share(uav(1), 0, 3, next)));
        IOptimisticSelection.Part memory first = part(uav(0), 2);
        IOptimisticSelection.Part memory second = part(uav(1), 2);
        vm.expectRevert(IOptimisticSelection.ClaimHolds.selector);
        claims.challengeTwice(1, 1, first, 1, second, 1);
        vm.expectRevert(IOptimisticSelection.ClaimHolds.selector);
        claims.challengeTwice(1, 1, first, 0, second, 1); // two vehicles
        claims.challengeTwice(1, 1, first, 0, second, 0);
        check(state(1) == IOptimisticSelection.State.Void, "void");
    }

    function word(uint256 key, address to, SignedProposal memory p, uint256 deadline) private view returns (bytes memory) {
        bytes32 inner = digest(
            keccak256(
                abi.encode(
                    PROPOSAL, to, 1, 1, int32(uint32(p.terms)), int32(uint32(p.terms >> 32)), uint32(p.terms >> 64),
                    uint32(p.terms >> 96), 0
                )
            )
        );
        bytes32 s = p.vs & bytes32(uint256(type(int256).max));
        bytes32 named = keccak256(abi.encodePacked(inner, p.r, s, uint8(27 + (uint256(p.vs) >> 255))));
        bytes32 kind = keccak256("Acknowledgement(bytes32 proposal,uint256 deadline)");
        (uint8 v, bytes32 r, bytes32 s_) = vm.sign(key, digest(keccak256(abi.encode(kind, named, deadline))));
        return abi.encodePacked(r, s_, v);
    }

    /// @dev A coordinator with a key, and a bond.
    function keyed() private returns (uint256 key, address coordinator) {
        key = 0xc0;
        coordinator = vm.addr(key);
        relay.grantRole(relay.COORDINATOR_ROLE(), coordinator);
        claims.transfer(coordinator, BOND);
    }

    function test_aBrokenWordIsProved() public {
        (uint256 key, address coordinator) = keyed();
        SignedProposal memory left = signed(1, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0));
        SignedProposal memory taken = signed(2, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0));
        IOptimisticSelection.Share[] memory list = shares(share(uav(0), 0, 1, one(taken)));
        sendAs = coordinator;
        claimBy(list);
        IOptimisticSelection.Part memory p = part(uav(0), 1);
        vm.expectRevert(IOptimisticSelection.ClaimHolds.selector);
        claims.challengeOmission(1, 1, p, taken, 5_000, word(key, uav(0), taken, 5_000));
        vm.expectRevert(IOptimisticSelection.ClaimHolds.selector);
        claims.challengeOmission(1, 1, p, left, 5_000, word(key + 1, uav(0), left, 5_000)); // another's word
        vm.expectRevert(IOptimisticSelection.ClaimHolds.selector);
        claims.challengeOmission(1, 1, p, left, 5_001, word(key, uav(0), left, 5_000));
        claims.challengeOmission(1, 1, p, left, 5_000, word(key, uav(0), left, 5_000));
        equal(claims.balanceOf(address(this)), SUPPLY - BOND / 2, "the challenger's");
    }

    function test_aBrokenWordAboutAUAVWithoutShareIsProved() public {
        (uint256 key, address coordinator) = keyed();
        sendAs = coordinator;
        claimBy(shares(share(uav(0), 0, 1, one(signed(2, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0))))));
        SignedProposal memory left = signed(1, Offer(uav(1), 1, 1, 5, -5, 100, 1_000, 0));
        IOptimisticSelection.Part memory p = part(uav(1), 1);
        // What is shown of a UAV without a share counts for nothing.
        p.rounds[0].share.proposals = one(left);
        claims.challengeOmission(1, 1, p, left, 5_000, word(key, uav(1), left, 5_000));
        check(state(1) == IOptimisticSelection.State.Void, "void");
    }

    address private sendAs;

    function claimBy(IOptimisticSelection.Share[] memory list) private {
        uint48 number = asOf();
        claimsAs(list, number, sendAs);
    }

    function claimsAs(IOptimisticSelection.Share[] memory list, uint48 number, address by) private {
        // The role is this contract's as well: it shows what `by` claims.
        IClaims real = claims;
        Forwarder forwarder = new Forwarder(real, by);
        claims = IClaims(address(forwarder));
        claimAsOf(list, number);
        claims = real;
    }

    function test_theBondComesBackOnceAndNotTooEarly() public {
        honest();
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Open));
        claims.finalise(1, 1);
        vm.roll(block.number - 1 + 3 * WINDOW);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Open));
        claims.finalise(1, 1);
        vm.roll(block.number + 1);
        vm.prank(CHALLENGER); // anyone may, and has nothing of it
        claims.finalise(1, 1);
        equal(claims.balanceOf(address(this)), SUPPLY, "back");
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Final));
        claims.finalise(1, 1);
        IOptimisticSelection.Part memory p = part(uav(0), 1);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Final));
        claims.challenge(1, 1, p);
    }

    function test_aWrongClaimCannotBeQuestionedAfterTheWindow() public {
        claim(shares(share(uav(0), 0, 0, one(proposeTo(uav(0), 1, 100, 1_000)))));
        vm.roll(block.number + 3 * WINDOW);
        IOptimisticSelection.Part memory p = part(uav(0), 1);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Open));
        claims.challenge(1, 1, p);
    }

    function test_oneWrongClaimIsOneBond() public {
        test_claimOfNobody();
        IOptimisticSelection.Part memory p = part(uav(0), 1);
        vm.prank(CHALLENGER);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Void));
        claims.challenge(1, 1, p);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Void));
        claims.finalise(1, 1);
        vm.roll(block.number + 3 * WINDOW + 1);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Void));
        claims.finalise(1, 1);
        equal(claims.balanceOf(address(claims)), 0, "nothing is left");
    }

    function test_nobodyClaimsWithoutBondOrRole() public {
        IOptimisticSelection.Share[] memory list =
            shares(share(uav(0), 0, 1, one(signed(1, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0)))));
        claims.transfer(CHALLENGER, SUPPLY);
        vm.expectRevert();
        claims.claim(1, 1, uint48(block.number - 1), list);
        vm.prank(CHALLENGER);
        vm.expectRevert();
        claims.claim(1, 1, uint48(block.number - 1), list);
        vm.expectRevert();
        relay.settle(1, 1, address(this), 1, 1);
        vm.expectRevert();
        relay.unsettle(1, 1);
    }

    function test_eachPeriodIsABondAndTheEighthBeforeHasToBeFinal() public {
        honest();
        for (uint256 period = 2; period <= 9; ++period) {
            relay.resetListsForZone(1);
            SignedProposal memory proposal = proposeAgain(1);
            IOptimisticSelection.Share[] memory list = shares(share(uav(0), 0, 1, one(proposal)));
            uint32 now_ = round(1);
            if (period == 9) {
                vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Open));
                claims.claim(1, now_, uint48(block.number - 1), list);
                vm.roll(block.number + 3 * WINDOW);
            }
            claims.claim(1, now_, uint48(block.number - 1), list);
            equal(claims.balanceOf(address(claims)), BOND * (period == 9 ? 8 : period), "each period's bond");
        }
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Open));
        claims.finalise(1, 1);
    }

    function test_strictProposalsKeepClaimsOut() public {
        vm.prank(vm.addr(2));
        relay.submitVehSelection(uav(0), 500, 1);
        IOptimisticSelection.Share[] memory list =
            shares(share(uav(0), 0, 1, one(signed(1, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0)))));
        vm.expectRevert(abi.encodeWithSelector(ProposalsUndecided.selector, 1));
        claims.claim(1, 1, uint48(block.number - 1), list);
        allocate(1);
        list = shares(share(uav(0), 0, 1, one(signed(1, Offer(uav(0), 1, 2, 5, -5, 100, 1_000, 0)))));
        vm.expectRevert(abi.encodeWithSelector(ZoneDecided.selector, 1));
        claims.claim(1, 2, uint48(block.number - 1), list);
    }

    function test_furtherRoundsDoNotKeepAChallengeOut() public {
        claim(shares(share(uav(0), 0, 0, one(proposeTo(uav(0), 1, 100, 1_000)))));
        claim(shares(share(uav(1), 0, 1, one(signed(2, Offer(uav(1), 1, 2, 5, -5, 100, 1_000, 0))))));
        proveWrong(uav(0), 1);
    }

    function test_whatIsShownMustBeWhatWasClaimed() public {
        honest();
        IOptimisticSelection.Part memory p = part(uav(0), 1);
        p.rounds[0].share.selected = 0;
        vm.expectRevert(IOptimisticSelection.NotClaimed.selector);
        claims.challenge(1, 1, p);
        p = part(uav(0), 1);
        p.rounds[0].record = Member.wrap(Member.unwrap(p.rounds[0].record) ^ 1);
        vm.expectRevert(IOptimisticSelection.NotClaimed.selector);
        claims.challenge(1, 1, p);
        p = part(uav(0), 1);
        p.rounds[0].leaves[0].uav = uav(1);
        vm.expectRevert(IOptimisticSelection.NotClaimed.selector);
        claims.challenge(1, 1, p);
        p.rounds = new IOptimisticSelection.Round[](0);
        vm.expectRevert(IOptimisticSelection.NotClaimed.selector);
        claims.challenge(1, 1, p);
    }

    function test_falseNumbersAreProvedOrRefused() public {
        SignedProposal memory proposal = proposeTo(uav(0), 1, 100, 1_000);
        IOptimisticSelection.Share[] memory list = shares(share(uav(0), 5, 1, one(proposal)));
        vm.expectRevert(); // fewer than none would be selected
        claims.claim(1, 1, uint48(block.number - 1), list);
        claim(shares(share(uav(0), 0, 1, one(proposal))));
        claim(shares(share(uav(0), 0, 3, one(signed(2, Offer(uav(0), 1, 2, 5, -5, 100, 1_000, 0))))));
        proveWrong(uav(0), 2); // the UAV counted twice
    }

    function test_uavsThatTakeNothingHaveNoShare() public {
        SignedProposal memory proposal = proposeTo(uav(0), 1, 100, 1_000);
        IOptimisticSelection.Share[] memory list = new IOptimisticSelection.Share[](2);
        list[0] = list[1] = share(uav(0), 0, 1, one(proposal));
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.UnfitShare.selector, uav(0)));
        claims.claim(1, 1, uint48(block.number - 1), list);
        list = shares(share(uav(0), 0, 1, new SignedProposal[](0)));
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.UnfitShare.selector, uav(0)));
        claims.claim(1, 1, uint48(block.number - 1), list);
        list = shares(share(uav(0), 0, 1, one(proposal)));
        vm.warp(block.timestamp + 3_601);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.UnfitShare.selector, uav(0)));
        claims.claim(1, 1, uint48(block.number - 1), list);
        vm.warp(1_000);
        relay.suspendMember(uav(0), true);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.UnfitShare.selector, uav(0)));
        claims.claim(1, 1, uint48(block.number - 1), list);
    }

    /// @dev A reputation or a suspension of later does not make a right claim wrong, nor a wrong one right.
    function test_whatChangesAfterwardsDoesNotCount() public {
        SignedProposal[] memory both = new SignedProposal[](2);
        both[0] = proposeTo(uav(0), 1, 110, 2_000);
        both[1] = proposeTo(uav(0), 2, 100, 2_000);
        claim(shares(share(uav(0), 0, 1, both)));
        address[] memory members = new address[](2);
        uint16[] memory reputations = new uint16[](2);
        (members[0], members[1], reputations[0], reputations[1]) = (vm.addr(1), vm.addr(2), 0, 10_000);
        relay.setReputations(members, reputations);
        relay.suspendMember(vm.addr(1), true);
        expectHolds(uav(0), 1);
        vm.prank(uav(0));
        relay.updateUAVInfo(20_000, 0, 100, 9_000, 1_000);
        expectHolds(uav(0), 1);
        vm.roll(block.number + 3 * WINDOW - 1);
        expectHolds(uav(0), 1);
        vm.expectRevert(abi.encodeWithSelector(ReputationSettling.selector, vm.addr(1)));
        relay.setReputations(members, reputations);
        vm.roll(block.number + 2);
        relay.setReputations(members, reputations);
    }

    function test_claimsAreInTimeOrRefused() public {
        IOptimisticSelection.Share[] memory list = shares(share(uav(0), 0, 1, one(proposeAgain(1))));
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.OutOfTime.selector, block.number));
        claims.claim(1, 1, uint48(block.number), list);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.OutOfTime.selector, block.number - WINDOW - 1));
        claims.claim(1, 1, uint48(block.number - WINDOW - 1), list);
        uint48 first = uint48(block.number - WINDOW);
        claims.claim(1, 1, first, list);
        list = shares(share(uav(1), 0, 1, one(signed(2, Offer(uav(1), 1, 2, 5, -5, 100, 1_000, 0)))));
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotYourPeriod.selector, 1, 1));
        claims.claim(1, 2, first + 1, list);
        vm.roll(first + 2 * WINDOW + 1);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.OutOfTime.selector, first));
        claims.claim(1, 2, first, list);
        vm.roll(first + 2 * WINDOW);
        claims.claim(1, 2, first, list);
    }

    function test_aMemberCannotReachInThroughThePayment() public {
        claim(shares(share(uav(0), 0, 0, one(proposeTo(uav(0), 1, 100, 1_000)))));
        Reentrant thief = new Reentrant(claims);
        thief.challenge(part(uav(0), 1));
        equal(claims.balanceOf(address(thief)), BOND / 2, "half a bond");
        equal(thief.called(), 0, "nothing of the challenger's was called");
    }

    // Proved at once

    /// @dev What SkyRelay itself selects is taken, anything else is not.
    /// forge-config: default.fuzz.runs = 64
    function testFuzz_onlyWhatIsSelectedIsProved(uint256 seed, uint256 flip) public {
        IOptimisticSelection.Share[] memory list = new IOptimisticSelection.Share[](2);
        for (uint256 u = 0; u < 2; ++u) {
            SignedProposal[] memory proposals = new SignedProposal[](5);
            for (uint256 i = 0; i < 5; ++i) {
                seed = uint256(keccak256(abi.encode(seed)));
                proposals[i] = proposeTo(
                    uav(u), 1 + 5 * u + i, uint32(seed % 701), uint32(500 + (seed >> 32) % 2_500)
                );
            }
            list[u] = share(uav(u), 0, 0, proposals);
        }
        strict.allocateZone(1, 1_000);
        (list[0].selected, list[1].selected) = (right(uav(0)), right(uav(1)) ^ 1 << flip % 6);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.WrongShare.selector, uav(1)));
        claims.prove(1, 1, list);
        list[1].selected = right(uav(1));
        claims.prove(1, 1, list);
        equal(relay.getZoneInfo(1).selectedVehicles, strict.getZoneInfo(1).selectedVehicles, "vehicles");
        equal(relay.getZoneInfo(1).selectedUAVs, strict.getZoneInfo(1).selectedUAVs, "UAVs");
        equal(claims.balanceOf(address(this)), SUPPLY, "no bond");
    }

    function refuses(Offer memory o, uint256 key) private {
        IOptimisticSelection.Share[] memory list =
            shares(share(o.uav, 0, o.demand == 0 ? 0 : 1, one(signed(key, o))));
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.WrongShare.selector, o.uav));
        claims.prove(1, 1, list);
    }

    function test_whatWouldBeRefusedIsNotProved() public {
        refuses(Offer(uav(0), 1, 1, 5, -5, 701, 1_000, 0), 1);
        refuses(Offer(uav(0), 1, 1, 5, -5, 100, 4_001, 0), 1);
        refuses(Offer(uav(0), 1, 1, 5, -5, 100, 0, 0), 1);
        refuses(Offer(uav(0), 1, 1, 40_000, 0, 100, 1_000, 0), 1);
        refuses(Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 7), 1);
        refuses(Offer(uav(0), 1, 2, 5, -5, 100, 1_000, 0), 1); // for another round: nobody's signature
        refuses(Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0), 99); // no vehicle
        relay.suspendMember(vm.addr(1), true);
        refuses(Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0), 1);
    }

    function test_aVehicleIsProvedOnceAndAZoneToo() public {
        IOptimisticSelection.Share[] memory list = new IOptimisticSelection.Share[](2);
        list[0] = share(uav(0), 0, 1, one(signed(1, Offer(uav(0), 1, 1, 5, -5, 100, 1_000, 0))));
        list[1] = share(uav(1), 0, 1, one(signed(1, Offer(uav(1), 1, 1, 5, -5, 100, 1_000, 0))));
        vm.expectRevert(abi.encodeWithSelector(ProposalOpen.selector, vm.addr(1)));
        claims.prove(1, 1, list);
        list[1] = share(uav(1), 0, 1, one(signed(2, Offer(uav(1), 1, 1, 5, -5, 100, 1_000, 0))));
        list[0].before = 1; // a UAV that serves somebody already, as it says
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.WrongShare.selector, uav(0)));
        claims.prove(1, 1, list);
        list[0].before = 0;
        bytes32 role = relay.COORDINATOR_ROLE();
        vm.prank(CHALLENGER);
        vm.expectRevert(
            abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, CHALLENGER, role)
        );
        claims.prove(1, 1, list);
        claims.prove(1, 1, list);
        check(state(1) == IOptimisticSelection.State.Final, "final");
        list = shares(share(uav(2), 0, 1, one(signed(3, Offer(uav(2), 1, 2, 5, -5, 100, 1_000, 0)))));
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotYourPeriod.selector, 1, 1));
        claims.prove(1, 2, list);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotYourPeriod.selector, 1, 1));
        claims.claim(1, 2, uint48(block.number - 1), list);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Final));
        claims.finalise(1, 1);
    }

    function test_provingGivesTheBondOfThePeriodBeforeBackToItsClaimant() public {
        honest();
        for (uint256 period = 2; period <= 9; ++period) {
            relay.resetListsForZone(1);
        }
        IOptimisticSelection.Share[] memory list = shares(share(uav(0), 0, 1, one(proposeAgain(1))));
        uint32 now_ = round(1);
        vm.expectRevert(abi.encodeWithSelector(IOptimisticSelection.NotInState.selector, IOptimisticSelection.State.Open));
        claims.prove(1, now_, list);
        vm.roll(block.number + 3 * WINDOW);
        claims.prove(1, now_, list);
        equal(claims.balanceOf(address(this)), SUPPLY, "back");
        equal(claims.balanceOf(address(claims)), 0, "nothing is held");
    }

    function test_aReplayOfSixtyProposalsIsBelowAMillion() public {
        for (uint256 key = 13; key <= 60; ++key) {
            onBoth(vm.addr(key), abi.encodeCall(relay.registerVehicle, (0, 0, 10, 1)));
        }
        SignedProposal[] memory all = new SignedProposal[](60);
        for (uint256 i = 0; i < 60; ++i) {
            all[i] = proposeTo(uav(0), 1 + i, uint32(i), uint32(50 + i));
        }
        strict.allocateZone(1, 1_000);
        claim(shares(share(uav(0), 0, right(uav(0)) ^ 1 << 59, all)));
        IOptimisticSelection.Part memory p = part(uav(0), 1);
        bytes memory data = abi.encodeCall(claims.challenge, (1, 1, p));
        uint256 cost = 21_000 + 16 * data.length;
        uint256 before = gasleft();
        (bool success,) = address(claims).call(data);
        check(success, "wrong");
        cost += before - gasleft();
        check(cost < 1_000_000, "below a million");
    }
}

/// @notice Passes a claim on as another sender's.
contract Forwarder is Test {
    IClaims private immutable REAL;
    address private immutable BY;

    constructor(IClaims real, address by) {
        (REAL, BY) = (real, by);
    }

    fallback() external {
        vm.prank(BY);
        (bool success,) = address(REAL).call(msg.data);
        check(success, "passed on");
    }
}

/// @notice Would take a bond again and again, if anything of it were called.
contract Reentrant {
    IClaims private immutable CLAIMS;
    uint256 public called;

    constructor(IClaims claims) {
        CLAIMS = claims;
    }

    function challenge(IOptimisticSelection.Part calldata part) external {
        CLAIMS.challenge(1, 1, part);
    }

    fallback() external {
        ++called;
    }
}

/// @notice Coordinators, challengers and strangers who claim, question, finalise and pay, in any order.
contract ClaimHandler is Claiming {
    uint256 public opened;
    uint256 public voided;
    uint256 public finals;

    constructor() {
        deployBoth();
        addPair(2, 8, 3_000);
    }

    function bond() external view returns (uint256 held, uint256 open, uint256 supply) {
        uint32 period = relay.getZoneInfo(1).period;
        for (uint32 p = 1; p <= period; ++p) {
            if (state(p) == IOptimisticSelection.State.Open) ++open;
        }
        return (claims.balanceOf(address(claims)), open, claims.totalSupply());
    }

    function propose(uint256 seed, uint256 bits) external {
        SignedProposal[] memory list = new SignedProposal[](1 + seed % 3);
        for (uint256 i = 0; i < list.length; ++i) {
            list[i] = signed(1 + (seed >> 8 * i) % 8, Offer(uav(seed % 2), 1, round(1), 5, -5, 100, 1_000, 0));
        }
        claim(shares(share(uav(seed % 2), 0, bits % 8, list)));
        ++opened;
    }

    function question(uint256 u, uint256 rounds) external {
        proveWrongNow(uav(u % 2), 1 + rounds % 4);
        ++voided;
    }

    function proveWrongNow(address of_, uint256 rounds) private {
        IOptimisticSelection.Part memory p = part(of_, rounds);
        uint32 period = relay.getZoneInfo(1).period;
        vm.prank(CHALLENGER);
        claims.challenge(1, period, p);
    }

    function finish(uint256 back, uint256 blocks) external {
        vm.roll(block.number + blocks % 20);
        claims.finalise(1, relay.getZoneInfo(1).period - uint32(back % 3));
        ++finals;
    }

    function next() external {
        relay.resetListsForZone(1);
        delete shown;
    }

    function pay(uint256 amount) external {
        vm.prank(CHALLENGER);
        claims.transfer(address(this), amount % SUPPLY);
    }
}

/// @notice Bonds are neither made nor lost: what the contract holds belongs to periods that can be questioned.
contract ClaimInvariants is Claiming {
    ClaimHandler private _handler;

    function setUp() public {
        _handler = new ClaimHandler();
    }

    function targetContracts() external view returns (address[] memory targets) {
        targets = new address[](1);
        targets[0] = address(_handler);
    }

    /// forge-config: default.invariant.runs = 16
    /// forge-config: default.invariant.depth = 48
    function invariant_bondsAreConserved() public view {
        (uint256 held, uint256 open, uint256 supply) = _handler.bond();
        equal(supply, SUPPLY - _handler.voided() * (BOND / 2), "supply: half of each bond that was lost is gone");
        equal(held, open * BOND, "held");
    }
}
