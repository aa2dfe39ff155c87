// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {Credit} from "../src/payment/Credit.sol";
import {ISkyRelayPayments} from "../src/payment/ISkyRelayPayments.sol";
import {Fixture} from "./Fixture.sol";

/// @notice SkyRelay with payments: vehicles whose keys are known, each with a deposit.
abstract contract PaymentsFixture is Fixture {
    uint32 internal constant ZONE = 1;
    uint40 internal constant SERVICE = 40;
    uint40 internal constant WINDOW = 60;
    uint32 internal constant PAYMENT = 500;
    uint32 internal constant DEMAND = 1_000;
    uint96 internal constant PRICE = 500_000;

    Credit internal credit;
    ISkyRelayPayments internal payments;

    function found() internal {
        vm.warp(1_000);
        deploy();
        credit = Credit(create(code("Credit")));
        payments = ISkyRelayPayments(
            create(bytes.concat(code("SkyRelayPayments"), abi.encode(relay, credit, SERVICE, WINDOW)))
        );
        check(address(payments) != address(0), "deployed");
        credit.mint(address(this), 1e15);
        credit.approve(address(payments), type(uint256).max);
    }

    function key(uint256 i) internal pure returns (uint256) {
        return 0xA11CE + i;
    }

    function payer(uint256 i) internal pure returns (address) {
        return vm.addr(key(i));
    }

    function join(uint256 i, uint96 deposit) internal {
        vm.prank(payer(i));
        relay.registerVehicle(int32(int256(i)), 0, PAYMENT, ZONE);
        if (deposit != 0) payments.deposit(payer(i), deposit);
    }

    function receipt(uint256 i, address to, uint32 period, uint96 amount)
        internal
        view
        returns (ISkyRelayPayments.Receipt[] memory receipts)
    {
        (uint8 v, bytes32 r, bytes32 s) = vm.sign(key(i), payments.receiptHash(payer(i), to, ZONE, period, amount));
        receipts = new ISkyRelayPayments.Receipt[](1);
        receipts[0] = ISkyRelayPayments.Receipt(
            payer(i), ZONE, period, amount, r, bytes32(uint256(s) | uint256(v - 27) << 255)
        );
    }

    function settle(uint256 i, address to, uint32 period, uint96 amount) internal {
        ISkyRelayPayments.Receipt[] memory receipts = receipt(i, to, period, amount);
        vm.prank(to);
        payments.settle(receipts);
    }

    function open(address to) internal returns (uint256) {
        vm.prank(to);
        return payments.open();
    }

    function claim(uint256 i, address to, uint32 period, uint96 amount) internal {
        vm.prank(payer(i));
        payments.claim(to, ZONE, period, amount);
    }

    function close(uint256 i) internal {
        address[] memory vehicles = new address[](1);
        vehicles[0] = payer(i);
        payments.close(vehicles);
    }

    function free(address member) internal view returns (uint96) {
        return payments.accountOf(member).free;
    }

    function present() internal view returns (uint32) {
        return relay.getZoneInfo(ZONE).period;
    }
}

contract PaymentsTest is PaymentsFixture {
    address private to;

    function setUp() public {
        found();
        to = addUAV(0, 20_000, ZONE);
    }

    function select(uint256 i) private {
        submit(payer(i), to, DEMAND, round(ZONE));
        allocate(ZONE);
    }

    /// @dev A vehicle with a deposit is selected, and its price is locked.
    function serve(uint256 i, uint96 deposit) private {
        join(i, deposit);
        select(i);
        equal(open(to), 1, "opened");
    }

    function refused(bytes memory refusal, address by, ISkyRelayPayments.Receipt[] memory r) private {
        vm.expectRevert(refusal);
        vm.prank(by);
        payments.settle(r);
    }

    function test_whatWasSignedIsPaidAndTheRestIsTheVehiclesAgain() public {
        serve(0, 2 * PRICE);
        equal(free(payer(0)), PRICE, "the rest of the deposit");
        settle(0, to, present(), 123_456);
        equal(free(to), 123_456, "paid");
        equal(free(payer(0)), 2 * PRICE - 123_456, "what is left");
        ISkyRelayPayments.Receipt[] memory again = receipt(0, to, present(), 123_456);
        refused(
            abi.encodeWithSelector(ISkyRelayPayments.NoAgreement.selector, payer(0), to, ZONE, present()), to, again
        );
    }

    function test_withoutAReceiptNothingIsPaid() public {
        serve(0, PRICE);
        close(0);
        equal(free(payer(0)), 0, "not before its time");
        vm.warp(1_000 + SERVICE + WINDOW);
        close(0);
        equal(free(payer(0)), 0, "nor at it");
        vm.warp(1_001 + SERVICE + WINDOW);
        ISkyRelayPayments.Receipt[] memory late = receipt(0, to, present(), 5);
        refused(
            abi.encodeWithSelector(ISkyRelayPayments.Expired.selector, 1_000 + SERVICE + WINDOW), to, late
        );
        close(0);
        equal(free(payer(0)), PRICE, "given back");
        equal(free(to), 0, "nothing paid");
        close(0);
        equal(free(payer(0)), PRICE, "once");
    }

    function test_aVehicleThatOffersWhatItHasNotLosesWhatItHas() public {
        join(0, PRICE - 1);
        select(0);
        equal(open(to), 0, "no agreement");
        equal(free(payer(0)), 0, "forfeited");
        equal(free(to), PRICE - 1, "to whom it deceived");
        payments.deposit(payer(0), 7);
        equal(open(to), 0, "and once");
        equal(free(payer(0)), 7, "what came later stays");
    }

    function test_aWithdrawalOnItsWayStillPays() public {
        join(0, PRICE);
        vm.prank(payer(0));
        payments.requestWithdrawal(PRICE);
        select(0);
        equal(open(to), 1, "opened");
        vm.warp(5_000);
        vm.expectRevert(ISkyRelayPayments.NothingToMove.selector);
        vm.prank(payer(0));
        payments.withdraw();
    }

    function test_aClaimOfLessThanWasSignedCostsThePrice() public {
        serve(0, PRICE);
        claim(0, to, present(), 10);
        settle(0, to, present(), 11);
        equal(free(to), PRICE, "all of it");
        equal(free(payer(0)), 0, "lost");
    }

    function test_anHonestClaimIsSettledSoonerAndCostsNothing() public {
        serve(0, PRICE);
        uint32 now_ = present();
        claim(0, to, now_, 10);
        vm.expectRevert(abi.encodeWithSelector(ISkyRelayPayments.AlreadyClaimed.selector, 10));
        claim(0, to, now_, 9);
        uint256 snapshot = vm.snapshotState();
        settle(0, to, present(), 10);
        equal(free(to), 10, "by the UAV's receipt");
        check(vm.revertToState(snapshot), "back");
        settle(0, to, present(), 3);
        equal(free(to), 10, "an older receipt takes nothing from what the vehicle owns to");
        check(vm.revertToState(snapshot), "back");
        vm.warp(1_001 + WINDOW);
        close(0);
        equal(free(to), 10, "or by the claim");
        equal(free(payer(0)), PRICE - 10, "the rest");
    }

    function test_aReceiptOfAnotherPeriodUAVOrSignerPaysNothing() public {
        serve(0, PRICE);
        serve(1, PRICE);
        bytes memory wrong = abi.encodeWithSelector(ISkyRelayPayments.WrongSignature.selector, payer(0));
        ISkyRelayPayments.Receipt[] memory other = receipt(1, to, present(), 9);
        other[0].vehicle = payer(0);
        refused(wrong, to, other);
        ISkyRelayPayments.Receipt[] memory more = receipt(0, to, present(), 9);
        more[0].amount = 10;
        refused(wrong, to, more);
        ISkyRelayPayments.Receipt[] memory before = receipt(0, to, present() - 1, 9);
        before[0].period = present();
        refused(wrong, to, before);
        ISkyRelayPayments.Receipt[] memory good = receipt(0, to, present(), 9);
        address thief = addUAV(1, 20_000, ZONE);
        refused(
            abi.encodeWithSelector(ISkyRelayPayments.NoAgreement.selector, payer(0), thief, ZONE, present()),
            thief,
            good
        );
        ISkyRelayPayments.Receipt[] memory beyond = receipt(0, to, present(), PRICE + 1);
        refused(abi.encodeWithSelector(ISkyRelayPayments.MoreThanAgreed.selector, PRICE + 1, PRICE), to, beyond);
        // The other s of the same signature is refused as well.
        uint256 order = 0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFEBAAEDCE6AF48A03BBFD25E8CD0364141;
        uint256 s = uint256(good[0].vs) & (type(uint256).max >> 1);
        good[0].vs = bytes32(((order - s) & (type(uint256).max >> 1)) | (uint256(good[0].vs) ^ 1 << 255) >> 255 << 255);
        refused(wrong, to, good);
    }

    function test_twoPeriodsCanWaitAndAThirdDoesNotForgetThem() public {
        join(0, 10 * PRICE);
        for (uint32 p = 1; p <= 3; ++p) {
            select(0);
            equal(open(to), p < 3 ? 1 : 0, "two agreements at a time");
            equal(open(to), 0, "each once");
            relay.resetListsForZone(ZONE);
        }
        equal(free(payer(0)), 8 * PRICE, "two prices locked");
        settle(0, to, present() - 3, 1);
        settle(0, to, present() - 2, 2);
        equal(free(to), 3, "both paid");
        equal(free(payer(0)), 10 * PRICE - 3, "both over");
    }

    function test_whoIsNotSelectedOwesNothing() public {
        join(0, PRICE);
        equal(open(to), 0, "nobody proposed");
        submit(payer(0), to, DEMAND, round(ZONE));
        equal(open(to), 0, "proposed is not selected");
        address other = addUAV(1, 20_000, ZONE);
        allocate(ZONE);
        equal(open(other), 0, "selected by another");
        equal(open(to), 1, "selected");
        vm.expectRevert();
        open(vehicle(77));
    }

    function test_aWithdrawalWaitsForTheWindow() public {
        payments.deposit(payer(0), 100);
        vm.prank(payer(0));
        vm.expectRevert(abi.encodeWithSelector(ISkyRelayPayments.InsufficientDeposit.selector, 100, 101));
        payments.requestWithdrawal(101);
        vm.prank(payer(0));
        payments.requestWithdrawal(60);
        vm.expectRevert(abi.encodeWithSelector(ISkyRelayPayments.NotYet.selector, 1_000 + WINDOW));
        vm.prank(payer(0));
        payments.withdraw();
        vm.warp(1_000 + WINDOW);
        vm.prank(payer(0));
        payments.withdraw();
        equal(credit.balanceOf(payer(0)), 60, "withdrawn");
        equal(free(payer(0)), 40, "left");
    }

    function test_aDepositWithoutTheMoneyIsNone() public {
        vm.expectRevert();
        vm.prank(payer(0));
        payments.deposit(payer(0), 1);
        vm.expectRevert(ISkyRelayPayments.NothingToMove.selector);
        payments.deposit(payer(0), 0);
    }
}

/// @notice Payers, UAVs and time, in any order.
contract PaymentsHandler is PaymentsFixture {
    uint256 internal constant UAVS = 3;
    uint256 internal constant PAYERS = 6;

    uint96 public paidIn;
    uint96 public paidOut;
    uint256 public agreements;
    uint256 public settlements;
    uint256 public claims;
    /// @dev What should have reverted and did not.
    string public violation;

    constructor() {
        found();
        for (uint256 i = 0; i < UAVS; ++i) {
            addUAV(i, 4_000, ZONE);
        }
        for (uint256 i = 0; i < PAYERS; ++i) {
            join(i, 0);
        }
    }

    function token() external view returns (Credit) {
        return credit;
    }

    function contractOf() external view returns (ISkyRelayPayments) {
        return payments;
    }

    function members() external pure returns (address[] memory all) {
        all = new address[](UAVS + PAYERS);
        for (uint256 i = 0; i < UAVS; ++i) {
            all[i] = uav(i);
        }
        for (uint256 i = 0; i < PAYERS; ++i) {
            all[UAVS + i] = payer(i);
        }
    }

    function payIn(uint256 i, uint96 amount) public {
        amount = uint96(bound(amount, 1, 2 * PRICE));
        payments.deposit(payer(i % PAYERS), amount);
        paidIn += amount;
    }

    function propose(uint256 i, uint256 u, uint256 demand) public {
        submit(payer(i % PAYERS), uav(u % UAVS), uint32(bound(demand, 1, DEMAND)), round(ZONE));
    }

    function select() public {
        relay.allocateZone(ZONE, type(uint256).max);
    }

    function nextPeriod(uint256 chance) public {
        if (chance % 3 == 0) relay.resetListsForZone(ZONE);
    }

    function agree(uint256 u) public {
        agreements += open(uav(u % UAVS));
    }

    /// @dev All that leads to an agreement, since chance alone seldom gets there.
    function serve(uint256 i, uint256 u) public {
        payIn(i, PRICE);
        propose(i, u, DEMAND - 1);
        select();
        agree(u);
    }

    function sign(uint256 i, uint256 k, uint96 amount) public {
        ISkyRelayPayments.Agreement memory agreed = payments.agreementsOf(payer(i % PAYERS))[k % 2];
        amount = uint96(bound(amount, 0, agreed.locked + agreed.locked / 8));
        uint96 before = free(agreed.uav);
        settle(i % PAYERS, agreed.uav, agreed.period, amount);
        uint96 paid = free(agreed.uav) - before;
        if (paid < amount) violation = "a UAV got less than it had been signed";
        if (paid > amount && !agreed.hasClaimed) violation = "a UAV got more than it had been signed";
        if (paid > agreed.locked) violation = "a UAV got more than the price";
        ++settlements;
    }

    function claimLess(uint256 i, uint256 k, uint96 amount) public {
        ISkyRelayPayments.Agreement memory agreed = payments.agreementsOf(payer(i % PAYERS))[k % 2];
        claim(i % PAYERS, agreed.uav, agreed.period, uint96(bound(amount, 0, agreed.locked + agreed.locked / 8)));
        ++claims;
    }

    function forge(uint256 i, uint256 u, uint96 amount) public {
        ISkyRelayPayments.Receipt[] memory receipts = receipt(i % PAYERS, uav(u % UAVS), present(), amount);
        receipts[0].vehicle = payer((i + 1) % PAYERS);
        vm.prank(uav(u % UAVS));
        try payments.settle(receipts) {
            violation = "a forged receipt was settled";
        } catch {}
    }

    function over(uint256 i) public {
        close(i % PAYERS);
    }

    function leave(uint256 i, bool isUAV, uint96 amount) public {
        address member = isUAV ? uav(i % UAVS) : payer(i % PAYERS);
        vm.prank(member);
        payments.requestWithdrawal(uint96(bound(amount, 1, PRICE)));
    }

    function takeOut(uint256 i, bool isUAV, uint256 chance) public {
        address member = isUAV ? uav(i % UAVS) : payer(i % PAYERS);
        if (chance % 4 == 0) vm.warp(block.timestamp + WINDOW);
        uint256 before = credit.balanceOf(member);
        vm.prank(member);
        payments.withdraw();
        paidOut += uint96(credit.balanceOf(member) - before);
    }

    function later(uint256 seconds_) public {
        vm.warp(block.timestamp + bound(seconds_, 1, SERVICE));
    }
}

contract PaymentsInvariants is PaymentsFixture {
    PaymentsHandler private handler;

    function setUp() public {
        handler = new PaymentsHandler();
    }

    function targetContracts() public view returns (address[] memory targets) {
        targets = new address[](1);
        targets[0] = address(handler);
    }

    /// @notice No money is made or lost: what lies in the contract is what its accounts and agreements say.
    function invariant_moneyIsConserved() public view {
        ISkyRelayPayments held = handler.contractOf();
        address[] memory all = handler.members();
        uint256 sum = 0;
        for (uint256 i = 0; i < all.length; ++i) {
            ISkyRelayPayments.Account memory account = held.accountOf(all[i]);
            sum += uint256(account.free) + account.leaving;
            ISkyRelayPayments.Agreement[2] memory pair = held.agreementsOf(all[i]);
            sum += uint256(pair[0].locked) + pair[1].locked;
        }
        equal(sum, handler.token().balanceOf(address(held)), "accounts and agreements against the token");
        equal(sum, uint256(handler.paidIn()) - handler.paidOut(), "against what was paid in and out");
        check(bytes(handler.violation()).length == 0, handler.violation());
    }
}
